"""The figures of the paper, from what the accuracy stage has found and the few fields that it
keeps."""

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


def draw(study: Study, results: dict, physics: list[dict]) -> dict[str, Figure]:
    """{name: figure} from the results of the accuracy stage; physics: what statistics.physics makes
    of them."""
    accuracy = results["accuracy"]
    models, dataset = accuracy["models"], study_dataset(study)
    test = load_samples(dataset, "test", None)
    names = main_models(study) | arm_models(study)
    names = {label: name for label, name in names.items() if name in models}
    fields = {label: field_of(study, dataset, models[name]) for label, name in names.items()}
    main = {label: field for label, field in fields.items() if label in main_models(study)}
    count = f"{len(accuracy['numbers'])} unseen interactions"
    configurations = {
        options_label(study.network(run).model): models[f"{run}: {KERAS}"]["depth"]
        for run in study.configurations
        if run in accuracy["runs"]
    }
    depths = {label: models[name]["depth"] for label, name in names.items()}
    violations = {label: models[name]["violation"] for label, name in names.items()}
    own = study.main[0].label
    return {
        "depth_configurations": figures.depth_curves(
            configurations, f"Configurations of the {own}, {count}"
        ),
        "depth_models": figures.depth_curves(depths, f"Error against depth, {count}"),
        "bland_altman": figures.bland_altman(dataset, test, fields),
        "test_interactions": figures.interaction_curves(
            accuracy["numbers"],
            accuracy["hard"],
            accuracy["force"],
            {"FEM": accuracy["fem_violation"]} | violations,
        ),
        "fields": sections.side_by_side(dataset, test, main),
        "quantization": bars.quantization(study, accuracy),
        "pruning": bars.pruning(study, accuracy),
        "physics": bars.physics(physics, own),
    }


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


def field_of(study: Study, dataset: Dataset, model: dict) -> np.ndarray:
    """The kept answer of an entry of the accuracy stage, see fields.kept_field."""
    return kept_field(study.cache / model["field"], dataset)


def animated_fields(study: Study, dataset: Dataset, accuracy: dict) -> dict[str, np.ndarray]:
    """{label: answer} of the main networks, for sections.animate."""
    return {
        label: field_of(study, dataset, accuracy["models"][name])
        for label, name in main_models(study).items()
        if label != LINEAR
    }
