"""Verdicts on the paper's statements: each falls both ways, and is left open where no run can
tell."""

import dataclasses

import pytest

from fem.errors import InputError
from unet_fem.study.measure import statistics
from unet_fem.study.report.claims import NOT, REPRODUCED, UNTESTED, claims
from unet_fem.study.settings import CLAIMS, Arm, Network, Order, load_study

CHANGES = (
    "scene=configs/tumour_tiny.toml",
    "data=data/tiny.h5",
)


@pytest.fixture
def case(study_of, results_of):
    """(study, results): two networks with three seeds each, four widths, three windows, and every
    statement."""
    study = study_of(2)
    runs = {}
    for name, own in (
        *((f"w{units}", (f"model.units={units}", "model.steps=2")) for units in (32, 64, 128)),
        *((f"s{steps}", ("model.units=64", f"model.steps={steps}")) for steps in (3, 4)),
        ("unet", ("model.kind=unet", "model.filters=4")),
    ):
        for seed in (1, 2, 3):
            runs[f"{name}_{seed}"] = (*CHANGES, *own, f"train.seed={seed}")
    networks = tuple(Network(name, "configs/paper.toml", own) for name, own in runs.items())
    main = tuple(
        dataclasses.replace(own, run=run)
        for own, run in zip(study.main, ("w64_1", "unet_1"), strict=True)
    )
    study = dataclasses.replace(
        study,
        networks=networks,
        main=main,
        configurations=("w32_1", "w64_1", "w128_1", "s3_1", "s4_1"),
        deployed=("w64_1", "unet_1"),
        learning_rate=("w64_1", "w64_2"),
        window=("w64_1", "s4_1"),
        physics=(Arm("without", ("w64_1", "w64_2", "w64_3")), Arm("gate", ("w32_1", "w32_2"))),
        order=(
            Order("CNN-LSTM", "U-Net", "first", 0.3),
            Order("U-Net", "linear regression", "second", 0.4),
        ),
        claims={name: name for name in CLAIMS},
    )
    results = results_of(study)
    err(results, "w64", 0.04)
    err(results, "unet", 0.08)
    err(results, "linear", 0.16)
    return study, results


def err(results, name, error, subset=None):
    """Give every model whose name begins so this relative L2, on all cases or on a subset."""
    accuracy = results["accuracy"]
    for own, model in accuracy["models"].items():
        if own.startswith(name):
            for n, (which, cases) in enumerate(accuracy["subsets"].items()):
                if subset in (None, which):
                    for m, case in enumerate(cases):
                        truth = 1.0 + m
                        share = error * (1 + 0.01 * (m - 1) + 0.001 * n)
                        model["sums"][case] = [truth * share**2, truth]
                    model[which]["relative_l2"] = error


def verdicts(case):
    study, results = case
    found = claims(study, results, statistics.physics(study, results["accuracy"]))
    return {says: verdict for says, _, verdict in found}


def widths(case, **errors):
    for run, facts in case[1]["accuracy"]["runs"].items():
        name = run.rsplit("_", 1)[0]
        facts["validation"] = errors.get(name, facts["validation"])


def test_the_order_of_networks_falls_both_ways(case):
    assert (verdicts(case)["first"], verdicts(case)["second"]) == (REPRODUCED, REPRODUCED)
    err(case[1], "w64", 0.07)  # less, but by far less than the paper says
    assert verdicts(case)["first"] == NOT
    err(case[1], "w64", 0.12)
    assert verdicts(case)["first"] == NOT and verdicts(case)["second"] == REPRODUCED


def test_the_order_is_judged_on_usual_interactions_alone(case):
    """Bug: the headline held a hard interaction with 58 % of its squared displacement."""
    err(case[1], "w64", 0.5, "hard")
    assert verdicts(case)["first"] == REPRODUCED
    err(case[1], "w64", 0.5, "usual")
    assert verdicts(case)["first"] == NOT


def test_one_seed_tests_no_order(case):
    study, results = case
    models = results["accuracy"]["models"]
    for name in [name for name in models if name.startswith("unet_3")]:
        del models[name]
    assert verdicts(case)["first"] == verdicts(case)["second"] == UNTESTED


def test_a_gate_that_never_opens_tests_nothing(case):
    """Bug: an arm whose gate stayed shut counted as "not reproduced"."""
    study, results = case
    assert verdicts(case)["volume"] == UNTESTED
    gate = ("w32_1", "w32_2", "w32_3")
    for run in gate:
        results["accuracy"]["runs"][run]["train_gate_open"] = 0.2
    err(results, "w32", 0.03)
    study = dataclasses.replace(study, physics=(study.physics[0], Arm("gate", gate)))
    assert verdicts((study, results))["volume"] == REPRODUCED
    err(results, "w32", 0.039)  # 2.5 % less is not 8
    assert verdicts((study, results))["volume"] == NOT
    err(results, "w32", 0.3)
    assert verdicts((study, results))["volume"] == NOT
    few = dataclasses.replace(study, physics=(study.physics[0], Arm("gate", gate[:2])))
    assert verdicts((few, results))["volume"] == UNTESTED


def test_width_pays_up_to_the_papers_choice_and_not_beyond(case):
    """Bug: this came out, and the page said that it was not reproduced."""
    widths(case, w32=0.3, w64=0.2, w128=0.21)
    assert verdicts(case)["units"] == REPRODUCED
    widths(case, w128=0.19)
    assert verdicts(case)["units"] == NOT
    widths(case, w32=0.1, w128=0.3)
    assert verdicts(case)["units"] == NOT
    del case[1]["accuracy"]["runs"]["w128_3"]
    assert verdicts(case)["units"] == UNTESTED


def test_a_longer_window_errs_less_and_takes_longer(case):
    seconds = case[1]["run_time"]["seconds"]
    for run, ms in (("w64_1", 2), ("s3_1", 3), ("s4_1", 4)):
        seconds[f"{run}: tf.function"] = dict.fromkeys(("p50", "bare"), 1e-3 * ms)
    widths(case, w64=0.3, s3=0.2, s4=0.1)
    assert verdicts(case)["steps"] == REPRODUCED
    widths(case, s4=0.25)
    assert verdicts(case)["steps"] == NOT
    widths(case, s4=0.1)
    seconds["s4_1: tf.function"]["p50"] = 1e-3
    assert verdicts(case)["steps"] == NOT


def test_harmless_and_harmful_are_opposites(case):
    for form in ("float16", "int8"):
        for run in ("w64_1", "unet_1"):
            err(case[1], f"{run}: {form}", 0.04 if run == "w64_1" else 0.08)
    assert (verdicts(case)["float16"], verdicts(case)["int8"]) == (REPRODUCED, NOT)
    for form in ("float16", "int8"):
        err(case[1], f"unet_1: {form}", 0.1)
    assert (verdicts(case)["float16"], verdicts(case)["int8"]) == (NOT, REPRODUCED)


def test_pruning_must_be_faster_at_equal_error(case):
    study, results = case
    seconds = results["run_time"]["seconds"]
    study = dataclasses.replace(study, main=study.main[:1], order=(), paper_latency={})
    base, pruned = "w64_1: float32", "w64_1_pruned50: float32"
    seconds[base]["p50"], seconds[pruned]["p50"] = 2e-3, 1e-3
    err(results, "w64_1_pruned50", 0.04)
    assert verdicts((study, results))["pruning"] == REPRODUCED
    err(results, "w64_1_pruned50", 0.05)
    assert verdicts((study, results))["pruning"] == NOT
    err(results, "w64_1_pruned50", 0.04)
    seconds[pruned]["p50"] = 1.9e-3
    assert verdicts((study, results))["pruning"] == NOT


def test_latency_is_no_longer_than_the_papers_or_it_is(case):
    study, results = case
    study = dataclasses.replace(study, paper_latency={"U-Net": 0.022})
    own = results["run_time"]["seconds"]["unet_1: tf.function"]
    own["p50"] = 0.021
    assert verdicts((study, results))["latency"] == REPRODUCED
    own["p50"] = 0.023
    assert verdicts((study, results))["latency"] == NOT


def test_a_fem_that_answers_in_time_contradicts_the_paper(case):
    results = case[1]
    (point,) = [p for p in results["fixed_latency"]["points"] if p["frame"] == 0.01]
    time = results["run_time"]["seconds"][point["name"]]
    time["p50"] = 0.009
    assert verdicts(case)["fem"] == NOT
    time["p50"] = 0.011
    assert verdicts(case)["fem"] == REPRODUCED
    time["p50"], point["usual"]["relative_l2"] = 0.009, 0.5
    assert verdicts(case)["fem"] == REPRODUCED


def test_only_what_the_settings_quote_is_judged(case):
    study, results = case
    silent = dataclasses.replace(study, claims={}, order=())
    assert verdicts((silent, results)) == {}
    with pytest.raises(InputError, match="'depth' is not one of volume, units"):
        dataclasses.replace(study, claims={"depth": "yes"})


def test_every_competitor_has_the_same_budget_of_tries():
    """Bug: the U-Net's rate, precision and epochs were moved, the CNN-LSTM's never."""
    with pytest.raises(InputError, match="'tiny' has tries = 13, the study allows 1 to tries = 12"):
        study = load_study("configs/study_quick.toml")
        first = dataclasses.replace(study.networks[0], tries=13)
        dataclasses.replace(study, networks=(first, *study.networks[1:]))
