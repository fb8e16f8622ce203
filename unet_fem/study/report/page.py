"""docs/results.md and the measured part of README: the study's tables and figures, from the figures
of its stages alone.

The text stands in docs/templates, and every number in it is filled in.
"""

import json
from pathlib import Path

import jinja2

from fem.errors import InputError
from fem.files import write_text
from unet_fem.study.dataset import study_dataset
from unet_fem.study.measure import statistics
from unet_fem.study.measure.extremes import KNOWN, OUTCOMES
from unet_fem.study.measure.points import (
    LONGEST,
    SHORTEST,
    against_fem,
    least_errors,
    pareto,
    points,
)
from unet_fem.study.measure.run_time import ENOUGH
from unet_fem.study.report import (
    best_choice,
    claims,
    error_vs_time,
    force_range,
    numbers,
    paper_figures,
    time_dependence,
)
from unet_fem.study.runs import KERAS
from unet_fem.study.settings import Study
from unet_fem.study.stages import STAGES
from unet_fem.training.figures import LIMIT_SHARE
from unet_fem.training.style import save

DOCS = Path("docs")
TEMPLATES = DOCS / "templates"
ELSEWHERE = {  # pages of other commands, where they are: what they hold
    "learning_curve.md": "error against the number of interactions, and what each costs",
    "learning_curve_58.md": "the same at the paper's number, every learned answer",
    "tissues.md": "the constitutive network in other tissues",
    "ablation.md": "memory and elasticity in the input of the paper's networks",
    "stability.md": "the map of the solver's own limits",
}
BEGIN, END = "<!-- results: written by tools/report.py -->", "<!-- end of results -->"


def write(study: Study, results: dict[str, dict], out: Path, readme: Path | None = None) -> Path:
    """Write <out>/results.md, the figures and the measurements behind both under <out>/results/,
    and between the markers of `readme` its part. Returns the page's path. Raises InputError where
    the templates or the markers are missing."""
    physics = statistics.physics(study, results["accuracy"])
    text = render(study, results, physics)
    folder = out / "results"
    folder.mkdir(parents=True, exist_ok=True)
    for name, figure in figures(study, results, physics).items():
        save(figure, folder / f"{name}.png")
    paper_figures.animate(study, results["accuracy"], folder / "hard_interaction.gif")
    own = {"best_choice": best_choice.choices(study, results)}
    for name, result in (results | own).items():
        write_text(folder / f"{name}.json", json.dumps(result, allow_nan=False) + "\n")
    path = out / "results.md"
    write_text(path, text)
    if readme:
        part = render(study, results, physics, "readme.md.j2")
        write_text(readme, between_markers(readme.read_text(), part))
    return path


def between_markers(text: str, part: str) -> str:
    """`text` with `part` between its markers. Raises InputError where they are missing."""
    if not 0 <= text.find(BEGIN) < text.find(END):
        raise InputError(f"README has no lines '{BEGIN}' and '{END}'; put them back")
    before, rest = text.split(BEGIN, 1)
    return f"{before}{BEGIN}\n\n{part.strip()}\n\n{END}{rest.split(END, 1)[1]}"


def figures(study: Study, results: dict[str, dict], physics: list[dict]) -> dict:
    """{name: figure} of the page."""
    found = {"error_vs_time": error_vs_time.draw(study, results)}
    found["best_choice"] = best_choice.draw(study, results)
    if "time_dependence" in results:
        found["time_dependence"] = time_dependence.draw(results["time_dependence"])
    if "force_range" in results:
        found["stability"] = force_range.draw(results["force_range"])
    return found | paper_figures.draw(study, study_dataset(study), results["accuracy"], physics)


def render(
    study: Study, results: dict[str, dict], physics: list[dict], name: str = "results.md.j2"
) -> str:
    """A page as Markdown; physics: what statistics.physics makes of the results."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(templates()),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {
        "percent": numbers.percent,
        "milliseconds": numbers.milliseconds,
        "interval": numbers.interval,
        "median": numbers.median,
        "difference": numbers.difference,
        "figures": numbers.figures,
        "given": numbers.given,
    }
    text = environment.get_template(name).render(shown(study, results, physics))
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
    configured = [run for run in study.configurations if run in runs]
    chosen = [r for r in dict.fromkeys((*study.learning_rate, *study.window)) if r in runs]
    reference = {"refined": None} | results["reference"]
    return {
        "study": study,
        "level": f"{100 * statistics.LEVEL:g}",
        "rules": {name: getattr(claims, name) for name in ("SEEDS", "SHARE", "EQUAL")},
        "enough": ENOUGH,
        "band": LIMIT_SHARE,
        "machine": timed["machine"],
        "reference": reference,
        "headline": {name: len(cases) for name, cases in reference["subsets"].items()},
        "accuracy": accuracy,
        "trained_on": accuracy["trained_on"],
        "missing": missing(study, accuracy),
        "unmeasured": [name for name in STAGES if name not in results],
        "fronts": [_front(results, frame) for frame in study.fem.frames],
        "best": best_choice.choices(study, results),
        "window": (SHORTEST, LONGEST),
        "against": [row | {"hours": _hours(row)} for row in against_fem(study, results)],
        "stopped": [point for point in results["fixed_latency"]["points"] if point["stopped"]]
        + [{"name": name} | model for name, model in models.items() if model.get("stopped")],
        "tuned_on": results["fixed_latency"]["tuned_on"],
        "tuning": tuning(study, results),
        "every": [
            {"interactions": 0, "hard_in_training": False, "errors": None}
            | every.get(name, {})
            | {"name": name, "times": times}
            for name, times in sorted(timed["seconds"].items())
        ],
        "claims": claims.claims(study, results, physics),
        "configuration_options": list(study.network(study.main[0].run).model.own()),
        "configurations": [
            {"label": numbers.options_tuple(study.network(run).model)}
            | {"seeds": sum(own in runs for own in study.replicas(run))}
            | _facts(accuracy, run)
            for run in configured
        ],
        "models": [
            {"name": model["run"] or name, "model": model, "facts": _facts_of(runs, model)}
            for name, model in models.items()
            if model["run"] is None or model["form"] == KERAS
        ],
        "physics": [_differences(arm) for arm in physics],
        "deployed": _deployed(study, models, timed["seconds"]),
        "choices": [
            {"name": run, "settings": study.network(run)} | _facts(accuracy, run) for run in chosen
        ],
        "creep": _creep(results.get("time_dependence")),
        "stability": results.get("force_range"),
        "extremes": _extremes(results.get("extremes")),
        "elsewhere": {name: own for name, own in ELSEWHERE.items() if (DOCS / name).is_file()},
    }


def missing(study: Study, accuracy: dict) -> list[str]:
    """Names of the networks and answers of the study that have no results."""
    answered = {name.split(" / ")[0] for name in accuracy["models"]}
    networks = [network.name for network in study.networks if network.name not in accuracy["runs"]]
    return networks + [own.label for own in study.answers if own.label not in answered]


def tuning(study: Study, results: dict[str, dict]) -> list[dict]:
    """[{"name", "tries"}]: settings that were tried for each competitor; of the FEM's loops and of
    the regressions the most."""
    loops = results["fixed_latency"]["tries"].values()
    models, runs = results["accuracy"]["models"], results["accuracy"]["runs"]
    fitted = [m["tries"] for m in models.values() if m["kind"] == "regression"]
    rows = [{"name": "FEM's loops, each", "tries": max(loops)}]
    rows += [{"name": "regressions, each", "tries": max(fitted)}] if fitted else []
    rows += [{"name": own.name, "tries": own.tries} for own in study.networks if own.name in runs]
    return rows + [{"name": own.label, "tries": own.tries} for own in study.answers]


def _front(results, frame):
    """The points that no other beats, on either set of interactions, from the fastest on, and what
    errs least in so much time."""
    found = sorted(points(results, frame), key=lambda point: point["seconds"])
    best = {point["name"] for subset in ("usual", "hard") for point in pareto(found, subset)}
    return {
        "frame": frame,
        "points": [point for point in found if point["name"] in best],
        "budgets": least_errors(found),
    }


def _hours(row):
    if row["own"]["kind"] == "answer" and row["training_s"] is None:
        return "-"
    return f"{row['hours']:.2g}" if row["hours"] else "never"


def _facts(accuracy, run):
    return {"facts": accuracy["runs"][run], "model": accuracy["models"][f"{run}: {KERAS}"]}


def _facts_of(runs, model):
    """parameters, train and validation of a run, or of what has none of its own."""
    return {"parameters": None, "train": None, "validation": None} | runs.get(model["run"], model)


def _differences(arm):
    """An arm of statistics.physics; the first has no differences, it is compared with."""
    return {f"{which}_difference": None for which in ("usual", "strong", "hard")} | arm


def _creep(found):
    if found is None:
        return []
    trained = found["trained_s"]
    return [part | {"title": time_dependence.title(part, trained)} for part in found["parts"]]


def _extremes(found):
    """The stage with the labels of its columns, how often each of them ends how, and how many of
    the loads the guard's features were chosen by."""
    if found is None:
        return None
    rows = [row for name in ("loads", "tissues", "frames") for row in found[name]]
    labels = list(dict.fromkeys(label for row in rows for label in row["answers"]))
    cells = {
        label: [row["answers"][label]["outcome"] for row in rows if label in row["answers"]]
        for label in labels
    }
    return found | {
        "labels": labels,
        "known": KNOWN,
        "counts": {
            label: {outcome: own.count(outcome) for outcome in OUTCOMES if outcome in own}
            for label, own in cells.items()
        },
    }


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
        if name in seconds and model["run"] and (model["run"] in main or model["parent"] in main)
    ]
