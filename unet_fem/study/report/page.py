"""docs/results.md: the study's tables and figures, from the figures of its stages alone."""

import json

from unet_fem.study.measure import statistics
from unet_fem.study.measure.points import against_fem, pareto, points
from unet_fem.study.report import error_vs_time, force_range, paper_figures, time_dependence
from unet_fem.study.report.claims import claims, percent
from unet_fem.study.report.error_vs_time import PAPER, plt

CAPTIONS = {
    "error_vs_time": "Relative L2 error against the converged reference over run time a frame, both logarithmic; above the unseen test interactions, below the hard ones; left a"
    " new force every 10 ms, right every 250 ms. Down and to the left is better. The red steps join what nothing else beats in both. The lines of the FEM join numbers of time steps a frame.",
    "depth_configurations": "Error over depth, 0 at the loaded surface and 1 at the held bottom: left the mean distance of a node from the FEM, right relative L2 in each layer; a line for each configuration.",
    "depth_models": "The same for linear regression, both networks and the arms of the volume term.",
    "bland_altman": "Bland-Altman: prediction less FEM over the mean of both, nodes of all test frames (colour: how many). Solid line: bias; dashed: limits that hold 96 % of the nodes.",
    "fields": "Displacement on a section through the hardest push of the test interactions, in mm, and below each model its error on the FEM's shape.",
    "hard_interaction": "The same interaction over time: FEM and both networks, their errors, and the total force of both contacts.",
    "test_interactions": "Largest total force and largest change of volume of each test interaction; the hard ones are shaded.",
    "physics": "Relative L2 error without and with the volume term: mean over the seeds with a 95 % bootstrap interval over interactions, and each seed as a cross.",
    "quantization": "Relative L2 error of every form of both networks.",
    "pruning": "Relative L2 error after pruning and fine-tuning, as Keras models.",
    "time_dependence": "Left: error over time. Middle: size of each answer in elastic answers; the black line is the tissue's creep. Right: share of the squared error that is missing time"
    " dependence. Grey: times that the networks were trained on.",
    "stability": "Colour: relative L2 error over time and over the factor on the contact forces, a panel for each competitor; the elastic FEM has no memory, the other FEM panel is the"
    " loop of fewest steps a frame. The black line bounds errors within 10 %, hatching marks volumes out of the band, the dashed line forces beyond training.",
}


def write(study, results, out):
    """Write <out>/results.md, the figures and the measurements behind both under <out>/results/.
    Returns the page's path."""
    from fem.files import write_text

    folder = out / "results"
    folder.mkdir(parents=True, exist_ok=True)
    physics = statistics.physics(study, results["accuracy"])
    figures = {
        "error_vs_time": error_vs_time.draw(study, results),
        "time_dependence": time_dependence.draw(results["time_dependence"]),
        "stability": force_range.draw(results["force_range"]),
    } | paper_figures.draw(study, results, physics)
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png")
        plt.close(figure)
    paper_figures.animate(study, results, folder / "hard_interaction.gif")
    for name, result in results.items():
        write_text(folder / f"{name}.json", json.dumps(result, allow_nan=False) + "\n")
    sections = [
        _head(study, results),
        _run_time(study, results),
        _claims(study, results, physics),
        _configurations(study, results),
        _models(study, results),
        _physics(study, physics),
        _deployment(study, results),
        _choices(study, results),
        _stability(study, results),
    ]
    path = out / "results.md"
    write_text(path, "\n\n".join(sections) + "\n")
    return path


def table(head, rows):
    lines = ["| " + " | ".join(map(str, row)) + " |" for row in (head, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(head), *lines[1:]])


def picture(name):
    """A figure of the page with its caption."""
    kind = "gif" if name == "hard_interaction" else "png"
    return f"![{name.replace('_', ' ')}](results/{name}.{kind})\n\n*{CAPTIONS[name]}*"


def note(study, name):
    """What the study's file says about a section, as a paragraph of its own."""
    return [study.notes[name].strip()] if name in study.notes else []


def join(*paragraphs):
    return "\n\n".join(paragraphs)


def _head(study, results):
    machine, reference = results["run_time"]["machine"], results["reference"]
    libraries = ", ".join(f"{name} {version}" for name, version in machine["libraries"].items())
    refined = reference.get("refined")
    trust = f"half the step changes it by {100 * reference['half_step']['relative_l2']:.2g} %"
    if refined and refined["relative_l2"] is not None:
        trust += (
            f", a mesh of half the edge by {percent(refined['relative_l2'])} % (interactions {', '.join(map(str, refined['numbers']))}): closer than that to it is no"
            " closer to the tissue"
        )
    return join(
        "# Results: error against run time",
        f"Written by `python tools/report.py {'' if study.name == 'study' else '--quick'}`".rstrip(
            "` "
        )
        + f"` from `configs/{study.name}.toml`; the numbers behind it are in [results/](results/).",
        f"Run times: {machine['processor']}, one thread, batch 1, p50 of {machine['rounds']} turns of {machine['calls']} calls, all competitors taking turns in one process"
        f" (load {machine['load']}); Python {machine['python']}, {libraries}.",
        f"The reference of the headline figure is the FEM in full float64 at the true mass and {reference['safety']:g} of the critical step; {trust}. The dataset that the networks"
        f" learn from is {percent(reference['dataset']['test'], 2)} % away from it. Errors are relative L2 over free nodes and frames. Elsewhere on this page, and"
        f" for all {len(results['accuracy']['numbers'])} test interactions, they are against the dataset's FEM."
        + (
            f" At the true mass the reference stops in interaction {', '.join(map(str, reference['stopped']))}: left out there."
            if reference["stopped"]
            else ""
        ),
        *_missing(study, results),
        *note(study, "summary"),
    )


def _missing(study, results):
    """A sentence that names the networks that are not trained yet, where a page is drawn before the
    end."""
    names = [
        network.name
        for network in study.networks
        if network.name not in results["accuracy"]["runs"]
    ]
    return [f"**Not trained yet, and missing below: {', '.join(names)}.**"] if names else []


def _run_time(study, results):
    parts = ["## Error against run time", picture("error_vs_time"), *note(study, "run_time")]
    for frame in study.fem.frames:
        found = sorted(points(results, frame), key=lambda p: p["seconds"])
        best = {id(p) for split in ("test", "hard") for p in pareto(found, split)}
        rows = [
            (
                p["name"],
                p["family"],
                f"{1e3 * p['seconds']:.3g}",
                percent(p["test"]),
                percent(p["hard"]),
            )
            for p in found
            if id(p) in best
        ]
        parts += [
            f"Which no other beats in both, a new force every {1e3 * frame:g} ms:",
            table(("competitor", "family", "ms a frame", "test %", "hard %"), rows),
        ]
    rows = [
        (
            f"{1e3 * row['frame']:g}",
            row["own"]["name"],
            f"{1e3 * row['own']['seconds']:.2f}",
            percent(row["own"]["test"]),
            _named(row["equal"], "seconds", "none errs as little"),
            _named(row["timely"], "test", "none is as fast"),
            f"{row['training_s'] / 60:.0f}" if row["training_s"] else "-",
            f"{row['hours']:.2g}" if row["hours"] else "never",
        )
        for row in against_fem(study, results)
    ]
    timed = results["run_time"]
    head = (
        "frame ms",
        "competitor",
        "ms",
        "test %",
        "fastest FEM of no more error",
        "most accurate FEM in no more time",
        "training, min",
        "pays off after simulated hours",
    )
    parts += [
        "At equal error and at equal time, and what a learned competitor costs before its first answer: the data"
        f" {timed['data_frames'] * timed['data_frame_s'] / 60:.0f} min on one thread, besides the training on all cores. It pays off when its answers have saved as much time against the fastest FEM of no more error:",
        table(head, rows),
    ]
    stopped = [
        f"{p['name']} ({len(p['stopped'])})"
        for p in results["fixed_latency"]["points"]
        if p["stopped"]
    ]
    if stopped:
        parts.append(
            f"Left out, since the solver stopped in as many interactions: {', '.join(stopped)}."
        )
    found = {p["name"]: p for frame in study.fem.frames for p in points(results, frame)}
    every = [
        (
            name,
            *(f"{1e3 * times[q]:.3g}" for q in ("p50", "p90", "p99", "worst")),
            *(
                percent(found[name][split], 2) if name in found else "-"
                for split in ("test", "hard")
            ),
        )
        for name, times in sorted(results["run_time"]["seconds"].items())
    ]
    head = ("competitor", "p50 ms", "p90", "p99", "worst", "test %", "hard %")
    parts += [
        "<details><summary>Run time and error of every competitor</summary>\n",
        table(head, every),
        "</details>",
    ]
    return join(*parts)


def _named(point, what, otherwise):
    """A point of the headline figure with its run time or its error."""
    if point is None:
        return otherwise
    return f"{point['name']}: " + (
        f"{1e3 * point['seconds']:.2f} ms"
        if what == "seconds"
        else f"{percent(point['test'], 2)} %"
    )


def _claims(study, results, physics):
    rows = claims(study, results, physics)
    return join(
        "## The paper's claims",
        table(("claim", "paper", "here", "verdict"), rows),
        *note(study, "claims"),
    )


def _errors(facts, model):
    """Training, validation, test and hard error in %, as the tables of models show them."""
    return [percent(x) for x in (facts["train"], facts["validation"], model["test"], model["hard"])]


def _configurations(study, results):
    models, runs = results["accuracy"]["models"], results["accuracy"]["runs"]
    rows = []
    for name in (name for name in study.configurations if name in runs):
        choice, facts = study.network(name).model, runs[name]
        model = models[f"{name}: tf.function"]
        rows.append(
            (
                f"({choice.units}, {choice.steps})",
                f"{facts['parameters']:,}",
                facts["best_epoch"],
                *_errors(facts, model),
            )
        )
    head = (
        "CNN-LSTM (N_N, N_t)",
        "parameters",
        "best epoch",
        "training %",
        "validation %",
        "test %",
        "hard %",
    )
    return join(
        "## Configurations of the CNN-LSTM",
        table(head, rows),
        *note(study, "configurations"),
        picture("depth_configurations"),
    )


def _models(study, results):
    models, runs = results["accuracy"]["models"], results["accuracy"]["runs"]
    rows = []
    for name, model in models.items():
        if model["run"] is None or model["form"] == "tf.function":
            facts = runs[model["run"]] if model["run"] else model
            rows.append(
                (
                    model["run"] or name,
                    f"{facts['parameters']:,}",
                    *_errors(facts, model),
                    percent(model["violation_mean"], 2),
                    percent(max(model["violation"]), 2),
                    f"{percent(model['gate_open'], 2)} (at {percent(model['gate'])})",
                )
            )
    head = (
        "model",
        "parameters",
        "training %",
        "validation %",
        "test %",
        "hard %",
        "volume % mean",
        "worst",
        "test frames beyond the gate %",
    )
    largest = max(results["accuracy"]["fem_violation"])
    return join(
        "## All models",
        table(head, rows),
        f"The FEM's own volume changes by at most {percent(largest, 2)} % on the test interactions.",
        *note(study, "models"),
        picture("depth_models"),
        picture("bland_altman"),
        picture("fields"),
        picture("hard_interaction"),
        picture("test_interactions"),
    )


def _interval(x, digits=1):
    return percent(x["relative_l2"], digits) + (
        ""
        if x["low"] is None
        else f" ({percent(x['low'], digits)} to {percent(x['high'], digits)})"
    )


def _difference(x):
    if x is None:
        return "-"
    return f"{100 * x['difference']:+.1f}" + (
        "" if x["low"] is None else f" ({100 * x['low']:+.1f} to {100 * x['high']:+.1f})"
    )


def _physics(study, physics):
    rows = [
        (
            arm["label"],
            len(arm["runs"]),
            *(
                cell
                for which in ("test", "strong", "hard")
                for cell in (_interval(arm[which]), _difference(arm.get(f"{which}_difference")))
            ),
            percent(arm["train_gate_open"], 2),
            percent(arm["test_gate_open"], 2),
            percent(arm["violation_max"], 2),
        )
        for arm in physics
    ]
    head = (
        "volume term",
        "seeds",
        "test %",
        "difference, points",
        "strongest quarter %",
        "difference, points",
        "hard %",
        "difference, points",
        "gate open in training %",
        "in test %",
        "worst volume %",
    )
    return join(
        "## With and without the volume term",
        "Brackets hold 95 % bootstrap intervals over interactions, errors averaged over the seeds.",
        table(head, rows),
        *note(study, "physics"),
        picture("physics"),
    )


def _deployment(study, results):
    models, seconds = results["accuracy"]["models"], results["run_time"]["seconds"]
    rows = []
    for name, model in models.items():
        if (
            model["run"]
            and name in seconds
            and any(model["run"].startswith(main) for main in (study.cnn_lstm, study.unet))
        ):
            base = seconds[f"{model['run']}: tf.function"]["p50"]
            time = seconds[name]
            rows.append(
                (
                    name,
                    f"{1e3 * time['p50']:.2f}",
                    f"{1e3 * time['p99']:.2f}",
                    f"{base / time['p50']:.1f}x",
                    percent(model["test"], 2),
                    percent(model["hard"], 2),
                )
            )
    head = ("run: form", "p50 ms", "p99 ms", "faster than tf.function", "test %", "hard %")
    return join(
        "## Latency, quantization, pruning",
        f"thin: whole filters or units removed; pruned: zeros in the convolutions; the number is the share in %. The paper: {', '.join(f'{name} {1e3 * t:.0f} ms' for name, t in PAPER.items())}.",
        table(head, rows),
        *note(study, "deployment"),
        picture("quantization"),
        picture("pruning"),
    )


def _choices(study, results):
    models, runs, long = (
        results["accuracy"]["models"],
        results["accuracy"]["runs"],
        results["time_dependence"],
    )
    rows = []
    for name in (
        name for name in dict.fromkeys((*study.learning_rate, *study.window)) if name in runs
    ):
        settings, facts, model = study.network(name), runs[name], models[f"{name}: tf.function"]
        rate = f"{settings.train.learning_rate:g}, {settings.train.schedule}"
        rows.append(
            (
                name,
                rate,
                settings.model.steps,
                f"{facts['best_epoch']} of {facts['epochs']}",
                *_errors(facts, model),
            )
        )
    head = (
        "run",
        "learning rate",
        "window",
        "best epoch",
        "training %",
        "validation %",
        "test %",
        "hard %",
    )
    tables = []
    for part, title in (
        (long["short"], "as long as in training"),
        (long["long"], f"up to {long['long']['time'][-1]:g} s"),
    ):
        cells = [
            (
                a["label"],
                percent(a["overall"]["relative_l2"]),
                *(
                    f"{a['overall'][key]:.2f}" if a["overall"][key] is not None else "-"
                    for key in ("missed", "common", "along", "followed")
                ),
            )
            for a in part["answers"].values()
        ]
        tables += [
            f"{part['interactions']} interactions {title}; time dependence is {percent(part['time_dependence'])} % of the motion; the longer window changes the error by {_difference(part['window'])} points:",
            table(
                (
                    "answer",
                    "relative L2 %",
                    "missed",
                    "of its squared error at least",
                    "at most",
                    "followed",
                ),
                cells,
            ),
        ]
    return join(
        "## The paper's data choices",
        table(head, rows),
        *note(study, "choices"),
        "### Time dependence",
        "missed: share of the time dependence (viscoelastic less elastic answer) that an answer lacks, 1 for the elastic FEM. At least, at most: the share of"
        " the answer's squared error that this makes up, and all of its error in that direction. followed: how far the size of the answer follows the creep, 1 for the FEM.",
        *tables,
        *note(study, "time_dependence"),
        picture("time_dependence"),
    )


def _stability(study, results):
    found = results["force_range"]
    stops = [s for s in found["stops"] if s["what"] == "truth"]
    return join(
        "## Stability beside accuracy",
        f"Forces of {len(found['interactions'])} test interactions times {', '.join(f'{f:g}' for f in found['factors'])}. The FEM itself stopped, with a reason, in"
        f" {len(stops)} of {len(found['interactions']) * len(found['factors'])}.",
        *note(study, "stability"),
        picture("stability"),
    )
