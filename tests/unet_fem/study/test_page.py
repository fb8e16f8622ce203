"""The page of a study: its templates, its headline figure and what README shows of it, for any
number of networks and for none of their names."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb

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
from unet_fem.study.settings import load_study
from unet_fem.study.stages import STAGES, check_needed
from unet_fem.training.style import COLOURS

ROOT = Path(__file__).parents[3]


def rendered(study, results, *template):
    return page.render(study, results, statistics.physics(study, results["accuracy"]), *template)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_study_of_one_two_or_three_networks_has_a_page(study_of, results_of, count):
    study = study_of(count)
    results = results_of(study)
    text = rendered(study, results)
    assert not re.search(r"\bnan\b|\bNone\b|\binf\b|\{\{|\{%", text)
    tables = [line for line in text.splitlines() if line.startswith("|")]
    assert len(tables) > 90 and "python tools/report.py --quick" in text
    blocks = [block.splitlines() for block in text.split("\n\n") if block.startswith("|")]
    assert all(len({line.count(" | ") for line in block[2:]}) <= 1 for block in blocks)
    assert all(block[0].count("|") == block[1].count("|") for block in blocks)
    for main in study.main:
        assert f"| {main.run}: int8 |" in text and f"| {main.run}_thin50: {'int8'} |" in text
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


def test_a_study_without_trained_networks_has_a_page_that_says_so(study_of, results_of):
    study = study_of(2)
    results = results_of(study)
    accuracy = results["accuracy"]
    accuracy["runs"] = {}
    accuracy["models"] = {n: m for n, m in accuracy["models"].items() if not m["run"]}
    seconds = results["run_time"]["seconds"]
    results["run_time"]["seconds"] = {n: s for n, s in seconds.items() if ": " not in n}
    del results["time_dependence"], results["force_range"]
    text = rendered(study, results)
    assert "**Not yet run on this mesh, and missing below: tiny, tiny_other, tiny_unet.**" in text
    assert "missing below: time_dependence, force_range.**" in text
    assert "## Configurations" not in text and "## Latency" not in text
    assert not re.search(r"\bnan\b|\bNone\b|\binf\b", text)
    assert (
        text.count("| not tested |") == len(study.order) + len(study.claims) - 1
    )  # the FEM is there
    check_needed(results)
    del results["accuracy"]
    with pytest.raises(InputError, match="stage 'accuracy' is not measured"):
        check_needed(results)


def test_hard_and_usual_are_named_apart_with_medians_and_intervals(study_of, results_of):
    study = study_of(1)
    results = results_of(study)
    point = results["fixed_latency"]["points"][0]
    assert point["usual"]["relative_l2"] != point["hard"]["relative_l2"]
    row = next(x for x in rendered(study, results).splitlines() if x.startswith("| FEM full, 5"))
    assert "5.0 (4.5 to 5.5) | 5.0 (4.5 to 5.5) | 5.5 (5.0 to 6.1) |" in row


def test_every_learned_point_says_what_it_has_learned_from(study_of, results_of):
    study = study_of(1)
    results = results_of(study)
    model = results["accuracy"]["models"]["linear regression, 2 frames"]
    row = "| linear regression, 2 frames | linear | {} |"
    results["run_time"]["seconds"]["linear regression, 2 frames"]["p50"] = 1e-6  # on the front
    assert row.format("58") in rendered(study, results)
    model |= {"interactions": 1200, "hard_in_training": True}
    assert row.format("1,200, hard too") in rendered(study, results)
    labels = error_vs_time.draw(study, results).legends[0].get_texts()
    assert "linear (1,200 interactions, hard ones too)" in [text.get_text() for text in labels]


@pytest.mark.parametrize("name", ["results.md.j2", "readme.md.j2", "macros.j2"])
def test_no_template_has_a_number_of_its_own(name):
    """Bug: hand-typed numbers went stale, and one latency had three values on three pages."""
    text = (ROOT / page.TEMPLATES / name).read_text()
    bare = re.sub(r"\{#.*?#\}|\{\{.*?\}\}|\{%.*?%\}", "", text, flags=re.DOTALL)
    bare = re.sub(r"95 % limits|int8|float16|float32|float64|p50|p90|p99|L2", "", bare)
    assert not re.findall(r"\d+", bare)
    spoken = re.findall(r'"([^"]*)"', " ".join(re.findall(r"\{\{ picture\((.*?)\) \}\}", text)))
    assert not re.findall(r"\d", "".join(s for s in spoken if " " in s).replace("L2", ""))


def committed():
    """The study that the project shows and the measurements that are committed with its page."""
    results = {
        name: json.loads((ROOT / f"docs/results/{name}.json").read_text())
        for name in STAGES
        if (ROOT / f"docs/results/{name}.json").is_file()
    }
    return load_study(ROOT / "configs/study.toml"), results


def test_the_committed_page_and_readme_are_what_their_measurements_give(monkeypatch):
    monkeypatch.chdir(ROOT)
    study, results = committed()
    assert (ROOT / "docs/results.md").read_text() == rendered(study, results)
    text = (ROOT / "README.md").read_text()
    assert page.between_markers(text, rendered(study, results, "readme.md.j2")) == text


def test_a_readme_without_markers_is_refused():
    with pytest.raises(InputError, match="README has no lines"):
        page.between_markers("# A page", "part")
    text = f"a\n{page.BEGIN}\nold\n{page.END}\nb\n"
    assert page.between_markers(text, "new") == f"a\n{page.BEGIN}\n\nnew\n\n{page.END}\nb\n"


def test_templates_that_are_gone_are_named(study_of, results_of, monkeypatch):
    monkeypatch.setattr(page, "TEMPLATES", page.TEMPLATES / "gone")
    with pytest.raises(InputError, match="run the command from"):
        rendered(study_of(2), results_of(study_of(2)))


def test_colours_go_by_order_and_not_by_name():
    kinds = {"regression": ("a", "b", "c"), "network": ("first", "second"), "FEM": ("FEM, full",)}
    found = [
        {"kind": kind, "family": family} for kind, families in kinds.items() for family in families
    ]
    style = error_vs_time.styles(found)
    first, second = error_vs_time.PALETTES["network"][:2]
    assert style["first"] == first and style["second"] == second
    assert list(style) == ["FEM, full", "a", "b", "c", "second", "first"]
    assert len(set(style.values())) == len(style)


def test_no_palette_sets_a_green_beside_a_red():
    own = [colour for palette in error_vs_time.PALETTES.values() for colour, _ in palette]
    for colour in (*COLOURS, *own):
        red, green, blue = to_rgb(colour)
        assert green <= max(red, blue), colour
    assert len(set(own)) == len(own)


def test_a_number_that_is_zero_has_no_sign_and_none_is_a_dash():
    assert [numbers.given(x, "%.2f") for x in (-1e-14, -0.126, None)] == ["0.00", "-0.13", "-"]
    assert numbers.given(20) == "20" and numbers.percent(None) == "-"
    assert numbers.milliseconds(None) == "-" and numbers.milliseconds(np.float64(2e-3), 1) == "2.0"
