"""A study with any number of main networks, and results of its stages that nobody measured."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from unet_fem.study.runs import KERAS, smaller_runs
from unet_fem.study.settings import Main, Network, Order, Study, load_study

ROOT = Path(__file__).parents[3]
FORMS = (KERAS, "dynamic", "float16", "float32", "int8")


@pytest.fixture
def study_of(monkeypatch):
    """study_of(3): the quick study with so many main networks, the first two its own."""
    monkeypatch.chdir(ROOT)

    def make(count: int) -> Study:
        study = load_study("configs/study_quick.toml")
        changes = study.networks[1].changes
        more = [Network(f"net{n}", "configs/paper.toml", changes) for n in range(3, count + 1)]
        mains = (*study.main, *(Main(f"Net {own.name[3:]}", own.name, 1) for own in more))
        labels = [main.label for main in mains[:count]]
        return dataclasses.replace(
            study,
            networks=(*study.networks, *more),
            main=mains[:count],
            deployed=tuple(main.run for main in mains[:count]),
            paper_latency={
                name: s for name, s in study.paper_latency.items() if name in (*labels, "FEM")
            },
            order=tuple(
                Order(better, worse, f"{better} better than {worse}", 0.3)
                for better, worse in zip(labels, [*labels[1:], "linear regression"], strict=True)
            ),
        )

    return make


@pytest.fixture
def results_of():
    """results_of(study): results of every stage, in the form that it gives them."""
    return lambda study: _Results(study).stages()


class _Results:
    def __init__(self, study: Study):
        self.study, self.rng = study, np.random.default_rng(1)
        self.usual, self.hard = [f"test {n}" for n in (1, 2, 3)], ["test 4", "hard 1"]
        self.cases = [*self.usual, *self.hard]

    def stages(self) -> dict[str, dict]:
        return {
            "reference": self.reference(),
            "fixed_latency": {
                "points": [self.point(frame) for frame in (0.01, 0.25)],
                "tuned_on": [1, 2],
                "tries": {"FEM full, 5 steps / 10 ms": 9},
            },
            "accuracy": self.accuracy(),
            "time_dependence": self.time_dependence(),
            "force_range": self.force_range(),
            "extremes": self.extremes(),
            "run_time": self.run_time(),
        }

    def reference(self):
        return {
            "subsets": self.subsets(),
            "stopped": ["test 3"],
            "safety": 0.85,
            "dataset": self.errors(0.002),
            "half_step": {"relative_l2": 0.0007},
            "refined": {
                "relative_l2": 0.061,
                "element": "full",
                "tissue": {
                    "full": {"relative_l2": 0.085, "cases": ["test 1"]},
                    "mean_dilatation": {"relative_l2": 0.03, "cases": ["test 1"]},
                },
                "refined_to_tissue": {"relative_l2": 0.05},
            },
        }

    def subsets(self):
        return {"usual": self.usual, "hard": self.hard}

    def errors(self, usual):
        names = ("relative_l2", "median")
        ends = {"low": 0.9, "high": 1.1, "median_low": 0.9, "median_high": 1.1}
        return {
            subset: dict.fromkeys(names, share * usual)
            | {name: share * usual * end for name, end in ends.items()}
            | {"count": 2}
            for subset, share in (("usual", 1), ("hard", 1.1))
        }

    def point(self, frame):
        return {
            "name": f"FEM full, 5 steps / {1e3 * frame:g} ms",
            "element": "full",
            "coarse": False,
            "frame": frame,
            "steps": 5,
            "hourglass_stiffness": 0.2,
            "damping": 0.1,
            "rise": 0.5,
            "stopped": [],
        } | self.errors(0.05)

    def model(self, kind, family, run=None, parent=None, form="float32"):
        truth = np.arange(1.0, 1.0 + len(self.cases))
        error = truth * self.rng.uniform(0.01, 0.09, len(truth))
        test = float(np.sqrt(error.sum() / truth.sum()))
        own = {
            "kind": kind,
            "family": family,
            "run": run,
            "parent": parent,
            "form": form,
            "frames": 1,
            "frame": None,
            "interactions": 58,
            "hard_in_training": False,
            "tries": 5,
            "options": {},
            "made": [] if run else ["python -m unet_fem.train model.kind=linear"],
            "sums": dict(zip(self.cases, np.stack([error, truth], axis=1).tolist(), strict=True)),
            "headline": self.errors(test),
            "depth": {"depth": [0.0, 1.0], "mean_mm": [0.2, 0.1], "relative_l2": [0.2, 0.1]},
            "violation": dict.fromkeys(self.cases, 0.01),
            "violation_mean": 0.01,
            "gate": 0.07,
            "gate_open": 0.0,
        }
        own |= self.errors(test)
        return own | ({} if run else {"parameters": 1000, "train": 0.1, "validation": 0.2})

    def accuracy(self):
        models, runs = {}, {}
        every = [(network.name, None, "network family") for network in self.study.networks]
        every += [(run.name, run.parent, "network family") for run in smaller_runs(self.study)]
        for run, parent, family in every:
            for form in FORMS:
                models[f"{run}: {form}"] = self.model("network", family, run, parent, form)
            runs[run] = {
                "parameters": 12345,
                "train": 0.1,
                "validation": 0.2,
                "epochs": 2,
                "best_epoch": 2,
                "seconds": 60.0,
                "threshold": 0.07,
                "volume_scale": 1e3,
                "train_gate_open": 0.0,
                "validation_gate_open": 0.0,
            }
        models["linear regression, 2 frames"] = self.model("regression", "linear")
        return {
            "models": models,
            "runs": runs,
            "trained_on": 58,
            "subsets": self.subsets(),
            "headline": self.subsets(),
            "force": {case: 1.0 + n for n, case in enumerate(self.cases)},
            "fem_violation": dict.fromkeys(self.cases, 0.02),
        }

    def run_time(self):
        models = self.accuracy()["models"]
        names = [*models, *(name.replace(KERAS, "Keras call") for name in models)]
        names += [self.point(frame)["name"] for frame in (0.01, 0.25)]
        seconds = self.rng.uniform(1e-4, 1e-2, len(names))
        keys = ("p50", "p90", "p99", "worst", "bare")
        return {
            "seconds": {
                name: dict.fromkeys(keys, float(s)) for name, s in zip(names, seconds, strict=True)
            },
            "interaction_s": {"": 2.0},
            "simulated": 72,
            "machine": {
                "processor": "a processor",
                "rounds": 3,
                "calls": 3,
                "load": 0.5,
                "python": "3.11",
                "libraries": {"numpy": "2"},
            },
        }

    def time_dependence(self):
        answer = {"label": "an answer", "relative_l2": [None, 0.1], "creep": [None, 1.0]}
        answer |= {"along": [None, 0.5], "common": [None, 0.2]}
        shares = ("relative_l2", "missed", "common", "along", "followed")
        part = {
            "time": [0.0, 0.25],
            "creep": [None, 1.2],
            "interactions": 4,
            "time_dependence": 0.2,
            "window": {"difference": -0.01, "low": None, "high": None},
            "cases": ["test 1"],
            "solver": "explicit",
            "left_out": {"test 2": "inverted cell"},
            "answers": {"net": answer | {"overall": dict.fromkeys(shares, 0.5)}},
        }
        longer = part | {"time": [0.0, 30.0], "solver": "quasistatic"}
        return {"trained_s": 0.25, "factor": 1.1, "parts": [part, longer]}

    def extremes(self):
        keys = ("error", "worst", "evaluations", "reason")
        cell = dict.fromkeys(keys) | {"outcome": "accurate", "error": 0.01, "worst": 0.02}
        wrong = cell | {"outcome": "silently wrong", "error": 0.9}
        row = {"name": "a pull", "largest_mm": 1.0, "stopped": None}
        row |= {"answers": {"net": cell, "linear": wrong}}
        stopped = {"name": "x 9", "largest_mm": None, "stopped": "inverted cell", "answers": {}}
        return {"tolerance": 0.05, "loads": [row, stopped], "tissues": [], "frames": [row]}

    def force_range(self):
        names = ["truth", "linear regression", *(main.label for main in self.study.main)]
        table = [[None, 0.05], [None, 0.2]]
        own = {"relative_l2": table, "volume": [[0.0, 0.01]] * 2, "stopped": [[0, 0]] * 2}
        return {
            "factors": [0.5, 1.0],
            "time": [0.0, 0.25],
            "interactions": [1],
            "tolerance": 0.1,
            "band": 0.07,
            "alive": [[1, 1], [1, 1]],
            "flag": [[0, 0], [0, 1]],
            "stops": [{"what": "truth", "number": 1, "factor": 1.0}],
            "competitors": dict.fromkeys(names, own),
        }
