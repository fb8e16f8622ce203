"""The import paths of version 0.1 of unet_fem, see fem.former."""

from fem.former import Table

FORMER: Table = {
    "unet_fem.checkpoint": {
        "unet_fem.networks.files": "save_model load_model",
        "unet_fem.training.checkpoint": "Checkpoint",
        "fem.files": "write_text",
    },
    "unet_fem.config": {
        "unet_fem.training.settings": "LossChoice TrainChoice Settings load_settings",
    },
    "unet_fem.data": {
        "unet_fem.training.samples": "windows Samples load_samples scales batches",
    },
    "unet_fem.evaluate": {
        "unet_fem.training.judge": "error_metrics rest_volume predict table",
    },
    "unet_fem.extremes": {
        "unet_fem.training.extremes": "extreme_loads fem_response judge_extremes extremes_table",
    },
    "unet_fem.figures": {
        "unet_fem.training.depth": "normalised_depth",
        "unet_fem.training.figures": "draw_all error_vs_depth bland_altman test_interactions",
        "unet_fem.training.section": "displacement_fields",
    },
    "unet_fem.latency": {
        "unet_fem.deployment.exported": "lite_files",
        "unet_fem.deployment.latency": "use_threads fem_action peak_memory machine",
    },
    "unet_fem.lite": {
        "unet_fem.deployment.tflite": "VARIANTS export calibration_windows surrogate_facts",
        "unet_fem.deployment.tflite_graph": "audit",
    },
    "unet_fem.losses": {
        "unet_fem.training.losses": (
            "deformed_volume volume_loss direction_loss gate_open volume_violation "
            "RelativeError volume_at_rest"
        ),
    },
    "unet_fem.models": {
        "unet_fem.networks.unet": "unet",
        "unet_fem.networks.cnn_lstm": "cnn_lstm",
        "unet_fem.networks.layers": "float32_twin",
    },
    "unet_fem.prune": {
        "unet_fem.deployment.pruning": "magnitude_prune",
        "unet_fem.deployment.thinning": "thin",
        "unet_fem.deployment.twins": "rebuild legacy_twin",
    },
    "unet_fem.reexpress": {
        "unet_fem.deployment.conv2d": "reexpress",
    },
    "unet_fem.ridge": {
        "unet_fem.networks.ridge": "fit",
    },
    "unet_fem.stream": {
        "unet_fem.deployment.answers": "answers",
        "unet_fem.runtime.replay": "replay report read_interaction",
    },
    "unet_fem.train": {
        "unet_fem.training.fit": "build_model build_loss compile_model fit",
    },
    "unet_fem.study.frame_loop": {
        "fem.solver.frame_loop": (
            "Competitor:LoopSettings FrameLoop longest_step loop_mesh coarse_mesh"
        ),
    },
    "unet_fem.study.pod": {
        "fem.online.regression": "Regression",
        "unet_fem.networks.pod": "linear reduced truncated",
    },
    "unet_fem.study.statistics": {
        "unet_fem.study.measure.statistics": "relative_l2 interval difference intervals",
    },
}
GONE = {
    "unet_fem.latency.network_actions": "time the steppers of unet_fem.deployment.forms",
    "unet_fem.latency.surrogate_action": "use the step of a unet_fem.Surrogate",
    "unet_fem.config.ModelChoice": (
        "each kind of model has options of its own in unet_fem.networks.registry"
    ),
    "unet_fem.models.linear_regression": "use unet_fem.networks.pod.linear, or model.kind",
    "unet_fem.study.pod.predict": "use regression.predict(force)",
}
