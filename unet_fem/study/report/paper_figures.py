"""The figures of the paper, from what the accuracy stage has found and the few fields that it
keeps."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fem.data.dataset import Dataset
from unet_fem.study.dataset import study_dataset
from unet_fem.study.measure.fields import drawn_regression, kept_field
from unet_fem.study.report import bars, sections
from unet_fem.study.report.numbers import options_label
from unet_fem.study.runs import KERAS
from unet_fem.study.settings import LINEAR, Study
from unet_fem.training import figures
from unet_fem.training.samples import load_samples


def draw(study: Study, dataset: Dataset, accuracy: dict, physics: list[dict]) -> dict[str, Figure]:
    """{name: figure} from the results of the accuracy stage, of what is trained; physics: what
    statistics.physics makes of them."""
    models = accuracy["models"]
    test = load_samples(dataset, "test", None)
    usual = ~test.hard
    names = drawn(main_models(study) | arm_models(study), accuracy)
    fields = {label: field_of(study, dataset, models[name]) for label, name in names.items()}
    main = {label: field for label, field in fields.items() if label in main_models(study)}
    count = f"{len(accuracy['subsets']['usual'])} usual unseen interactions"
    configurations = {
        options_label(study.network(run).model): models[f"{run}: {KERAS}"]["depth"]
        for run in study.configurations
        if run in accuracy["runs"]
    }
    cases = [case for case in accuracy["force"] if case.startswith("test ")]
    number = {case: int(case.split()[1]) for case in cases}
    violations = {"FEM": accuracy["fem_violation"]}
    violations |= {label: models[name]["violation"] for label, name in names.items()}
    found = {
        "depth_models": figures.depth_curves(
            {label: models[name]["depth"] for label, name in names.items()},
            f"How does the error depend on depth? {count}",
        ),
        "bland_altman": figures.bland_altman(
            dataset, test.select(usual), {label: own[usual] for label, own in fields.items()}
        ),
        "test_interactions": figures.interaction_curves(
            np.array([number[case] for case in cases]),
            np.array([number[case] for case in cases if case in accuracy["subsets"]["hard"]]),
            np.array([accuracy["force"][case] for case in cases]),
            {label: np.array([own[case] for case in cases]) for label, own in violations.items()},
        ),
        "fields": sections.side_by_side(dataset, test, main),
    }
    if configurations:
        found["depth_configurations"] = figures.depth_curves(
            configurations, f"Which configuration of the {study.main[0].label} errs where? {count}"
        )
    if main.keys() - {LINEAR}:
        found["quantization"] = bars.quantization(study, accuracy)
        found["pruning"] = bars.pruning(study, accuracy)
    if physics:
        found["physics"] = bars.physics(physics, study.main[0].label)
    return found


def main_models(study: Study) -> dict[str, str]:
    """{label: name in the accuracy stage}: linear regression, and the main networks, the first at
    the end, beside the arms that vary it."""
    networks = {main.label: f"{main.run}: {KERAS}" for main in reversed(study.main)}
    return {LINEAR: drawn_regression(study)} | networks


def arm_models(study: Study) -> dict[str, str]:
    """The same of the first run of every arm of the volume term."""
    return {
        f"({options_label(study.network(arm.runs[0]).model)}) {arm.label}": (
            f"{arm.runs[0]}: {KERAS}"
        )
        for arm in study.physics
    }


def drawn(names: dict[str, str], accuracy: dict) -> dict[str, str]:
    """Those of {label: name} that have results."""
    return {label: name for label, name in names.items() if name in accuracy["models"]}


def field_of(study: Study, dataset: Dataset, model: dict) -> np.ndarray:
    """The kept answer of an entry of the accuracy stage to the split "test", see
    fields.kept_field."""
    rows = int(np.sum(dataset.split == "test")) * len(dataset.time)
    return kept_field(study.cache / model["field"], dataset)[:rows]


def animate(study: Study, accuracy: dict, path: Path) -> None:
    """Write the animation of the main models that have results, see sections.animate."""
    dataset = study_dataset(study)
    names = drawn(main_models(study), accuracy)
    own = {name: label for label, name in names.items() if label != LINEAR} or {
        name: label for label, name in names.items()
    }
    fields = {
        label: field_of(study, dataset, accuracy["models"][name]) for name, label in own.items()
    }
    sections.animate(dataset, load_samples(dataset, "test", None), fields, path)
