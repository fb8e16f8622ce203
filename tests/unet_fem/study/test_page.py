"""The page of a study: its templates, its claims and its headline figure, for any number of
networks and for none of their names."""

import re

import pytest

from fem.errors import InputError
from unet_fem.study.measure import statistics
from unet_fem.study.report import (
    bars,
    error_vs_time,
    force_range,
    numbers,
    page,
    time_dependence,
)
from unet_fem.study.report.claims import claims
from unet_fem.study.settings import load_study


def rendered(study, results):
    return page.render(study, results, statistics.physics(study, results["accuracy"]))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_study_of_one_two_or_three_networks_has_a_page(study_of, results_of, count):
    study = study_of(count)
    results = results_of(study)
    text = rendered(study, results)
    assert not re.search(r"\bnan\b|\bNone\b|\binf\b|\{\{|\{%", text)
    tables = [line for line in text.splitlines() if line.startswith("|")]
    assert len(tables) > 100 and "python tools/report.py --quick" in text
    blocks = [block.splitlines() for block in text.split("\n\n") if block.startswith("|")]
    assert all(len({line.count(" | ") for line in block[2:]}) <= 1 for block in blocks)
    for main in study.main:
        assert f"| {main.run}: int8 |" in text and f"| {main.run}_thin50: {'int8'} |" in text
        assert f"50 % pruned by zeros: {main.label}" in text
    for number in range(count, 3):  # of the networks that are not in this study
        assert f"net{number + 1}" not in text
    figures = [
        error_vs_time.draw(study, results),
        time_dependence.draw(results["time_dependence"]),
        force_range.draw(results["force_range"]),
        bars.quantization(study, results["accuracy"]),
        bars.pruning(study, results["accuracy"]),
    ]
    assert len(figures[-1].axes) == len(figures[-2].axes) == count


def test_the_remarks_on_a_study_stand_in_its_own_template_alone(study_of, results_of, monkeypatch):
    quick = study_of(2)
    assert "**In short.**" not in rendered(quick, results_of(quick))
    study = load_study("configs/study.toml")
    results = results_of(study)
    text = rendered(study, results)
    start = text.index("**In short.**")
    assert text.rindex("left out there.", 0, start) and start < text.index("## Error against")
    for remark in ("Wider helps up to 256", "int8 costs 0.2 points", "the band tells nothing"):
        assert remark in text
    with monkeypatch.context() as patch, pytest.raises(InputError, match="run the command from"):
        patch.setattr(page, "TEMPLATES", page.TEMPLATES / "gone")
        rendered(quick, results_of(quick))


def test_the_order_of_networks_is_a_claim_of_the_settings(study_of, results_of):
    study = study_of(3)
    results = results_of(study)
    models = results["accuracy"]["models"]
    for main, error in zip(study.main, (0.1, 0.2, 0.21), strict=True):
        models[f"{main.run}: tf.function"]["test"] = error
    models["linear regression, 2 frames"]["test"] = 0.2
    physics = statistics.physics(study, results["accuracy"])
    first, second, third = claims(study, results, physics)[:3]
    assert first == (
        "CNN-LSTM errs less than the U-Net",
        "by 30 %",
        "10.0 against 20.0 %, 50 % less",
        "reproduced",
    )
    assert second[0] == "U-Net errs less than the Net 3" and second[3] == "partly"
    assert third[0] == "Net 3 errs less than linear regression"
    assert third[3] == "**not reproduced**"


def test_colours_go_by_order_and_not_by_name():
    kinds = {"regression": ("a", "b", "c"), "network": ("first", "second"), "FEM": ("FEM, full",)}
    found = [
        {"kind": kind, "family": family} for kind, families in kinds.items() for family in families
    ]
    style = error_vs_time.styles(found)
    assert style["first"] == ("tab:orange", "^") and style["second"] == ("tab:blue", "o")
    assert list(style) == ["a", "b", "c", "second", "first", "FEM, full"]
    assert len(set(style.values())) == len(style)


def test_a_number_that_is_zero_has_no_sign_and_none_is_a_dash():
    assert [numbers.given(x, "%.2f") for x in (-1e-14, -0.126, None)] == ["0.00", "-0.13", "-"]
    assert numbers.given(20) == "20" and numbers.percent(None) == "-"
