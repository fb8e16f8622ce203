"""docs/results.md: the study's tables and figures, from the figures of its stages alone.

The text stands in docs/templates: results.md.j2, or what extends it under the study's own name.
"""

import json
from pathlib import Path

import jinja2

from fem.errors import InputError
from fem.files import write_text
from unet_fem.study.dataset import study_dataset
from unet_fem.study.measure import statistics
from unet_fem.study.measure.points import against_fem, pareto, points
from unet_fem.study.report import (
    error_vs_time,
    force_range,
    numbers,
    paper_figures,
    sections,
    time_dependence,
)
from unet_fem.study.report.claims import claims
from unet_fem.study.runs import KERAS
from unet_fem.study.settings import Study
from unet_fem.training.samples import load_samples
from unet_fem.training.style import save

TEMPLATES = Path("docs/templates")


def write(study: Study, results: dict[str, dict], out: Path) -> Path:
    """Write <out>/results.md, the figures and the measurements behind both under <out>/results/.
    Returns the page's path. Raises InputError where the templates are missing."""
    physics = statistics.physics(study, results["accuracy"])
    text = render(study, results, physics)
    folder = out / "results"
    folder.mkdir(parents=True, exist_ok=True)
    for name, figure in figures(study, results, physics).items():
        save(figure, folder / f"{name}.png")
    dataset = study_dataset(study)
    test = load_samples(dataset, "test", None)
    fields = paper_figures.animated_fields(study, dataset, results["accuracy"])
    sections.animate(dataset, test, fields, folder / "hard_interaction.gif")
    for name, result in results.items():
        write_text(folder / f"{name}.json", json.dumps(result, allow_nan=False) + "\n")
    path = out / "results.md"
    write_text(path, text)
    return path


def figures(study: Study, results: dict[str, dict], physics: list[dict]) -> dict:
    """{name: figure} of the page."""
    return {
        "error_vs_time": error_vs_time.draw(study, results),
        "time_dependence": time_dependence.draw(results["time_dependence"]),
        "stability": force_range.draw(results["force_range"]),
    } | paper_figures.draw(study, results, physics)


def render(study: Study, results: dict[str, dict], physics: list[dict]) -> str:
    """The page as Markdown; physics: what statistics.physics makes of the results."""
    folder = templates()
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {
        "percent": numbers.percent,
        "milliseconds": numbers.milliseconds,
        "interval": numbers.interval,
        "difference": numbers.difference,
        "figures": numbers.figures,
        "given": numbers.given,
    }
    template = environment.select_template([f"{study.name}.md.j2", "results.md.j2"])
    text = template.render(shown(study, results, physics))
    return text.rstrip() + "\n"


def templates() -> Path:
    """The folder of the templates: of this checkout, or under the folder that the command runs in.
    Raises InputError where there is none."""
    for root in (Path(__file__).parents[3], Path()):
        if (root / TEMPLATES / "results.md.j2").is_file():
            return root / TEMPLATES
    raise InputError(
        f"no {TEMPLATES / 'results.md.j2'}; run the command from a checkout of the project"
    )


def shown(study: Study, results: dict[str, dict], physics: list[dict]) -> dict:
    """What the templates show."""
    accuracy, timed = results["accuracy"], results["run_time"]
    models, runs = accuracy["models"], accuracy["runs"]
    every = {p["name"]: p for frame in study.fem.frames for p in points(results, frame)}
    untimed = {"test": None, "hard": None}
    configured = [run for run in study.configurations if run in runs]
    chosen = [r for r in dict.fromkeys((*study.learning_rate, *study.window)) if r in runs]
    creep = results["time_dependence"]
    return {
        "study": study,
        "machine": timed["machine"],
        "reference": {"refined": None} | results["reference"],
        "accuracy": accuracy,
        "missing": [network.name for network in study.networks if network.name not in runs],
        "fronts": [_front(results, frame) for frame in study.fem.frames],
        "data_s": timed["data_frames"] * timed["data_frame_s"],
        "against": against_fem(study, results),
        "stopped": [point for point in results["fixed_latency"]["points"] if point["stopped"]],
        "every": [
            {"name": name, "times": times} | _errors(every.get(name, untimed))
            for name, times in sorted(timed["seconds"].items())
        ],
        "claims": claims(study, results, physics),
        "configuration_options": list(study.network(study.main[0].run).model.own()),
        "configurations": [
            {"label": numbers.options_tuple(study.network(run).model)} | _facts(accuracy, run)
            for run in configured
        ],
        "models": [
            {"name": model["run"] or name, "model": model, "facts": runs.get(model["run"], model)}
            for name, model in models.items()
            if model["run"] is None or model["form"] == KERAS
        ],
        "physics": [_differences(arm) for arm in physics],
        "deployed": _deployed(study, models, timed["seconds"]),
        "choices": [
            {"name": run, "settings": study.network(run)} | _facts(accuracy, run) for run in chosen
        ],
        "creep": [
            creep["short"] | {"title": "as long as in training"},
            creep["long"] | {"title": f"up to {creep['long']['time'][-1]:g} s"},
        ],
        "stability": results["force_range"],
    }


def _front(results, frame):
    """The points that no other beats, on either set of interactions, from the fastest on."""
    found = sorted(points(results, frame), key=lambda point: point["seconds"])
    best = {point["name"] for split in ("test", "hard") for point in pareto(found, split)}
    return {"frame": frame, "points": [point for point in found if point["name"] in best]}


def _errors(point):
    return {split: point[split] for split in ("test", "hard")}


def _facts(accuracy, run):
    return {"facts": accuracy["runs"][run], "model": accuracy["models"][f"{run}: {KERAS}"]}


def _differences(arm):
    """An arm of statistics.physics; the first has no differences, it is compared with."""
    return {f"{which}_difference": None for which in ("test", "strong", "hard")} | arm


def _deployed(study, models, seconds):
    """The forms of the main runs and of what pruning made of them, beside their own Keras model."""
    main = [own.run for own in study.main]
    return [
        {
            "name": name,
            "model": model,
            "times": seconds[name],
            "base": seconds[f"{model['run']}: {KERAS}"]["p50"],
        }
        for name, model in models.items()
        if name in seconds and (model["run"] in main or model["parent"] in main)
    ]
