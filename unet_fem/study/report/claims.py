"""The paper's claims beside what was measured here, each with a verdict by rule."""

EQUAL = 0.02  # of itself: an error that grows by no more counts as the same
REPRODUCED, PARTLY, NOT = "reproduced", "partly", "**not reproduced**"


def percent(x, digits=1):
    return "-" if x is None else f"{100 * x:.{digits}f}"


def claims(study, results, physics):
    """[(claim, the paper's figure, found, verdict)] from the stages' results and
    statistics.physics."""
    models, runs, seconds = (
        results["accuracy"]["models"],
        results["accuracy"]["runs"],
        results["run_time"]["seconds"],
    )
    cnn, unet = models[f"{study.cnn_lstm}: tf.function"], models[f"{study.unet}: tf.function"]
    linear = models["linear regression, 1 frame"]
    rows = []
    for better, worse, title, paper in (
        (cnn, unet, "CNN-LSTM errs less than the U-Net", 0.31),
        (unet, linear, "U-Net errs less than linear regression", 0.45),
    ):
        gain = 1 - better["test"] / worse["test"]
        verdict = REPRODUCED if gain >= 0.8 * paper else PARTLY if gain > 0 else NOT
        rows.append(
            (
                title,
                f"by {percent(paper, 0)} %",
                f"{percent(better['test'])} against {percent(worse['test'])} %, {_by(gain)}",
                verdict,
            )
        )
    rows += [_gate(cnn, runs[study.cnn_lstm]), _physics(physics)]
    depth = cnn["depth"]
    top, bottom = depth["mean_mm"][0], depth["mean_mm"][-1]
    grows = all(a >= b for a, b in zip(depth["mean_mm"], depth["mean_mm"][1:]))
    rows.append(
        (
            "The error grows towards the loaded surface",
            "yes",
            f"mean error {top:.4f} mm there, {bottom:.4f} mm in the deepest free layer (CNN-LSTM)",
            REPRODUCED if grows else PARTLY if top > bottom else NOT,
        )
    )
    best = min(
        (run for run in study.configurations if run in runs),
        key=lambda run: runs[run]["validation"],
    )
    own = study.network(study.cnn_lstm).model
    rows.append(
        (
            f"Of the configurations ({own.units}, {own.steps}) is the best",
            "yes",
            f"least on validation: {best}, {percent(runs[best]['validation'])} %; this one: {percent(runs[study.cnn_lstm]['validation'])} %",
            REPRODUCED if best == study.cnn_lstm else NOT,
        )
    )
    for form, says in (("float16", "harmless"), ("int8", "harmful")):
        lost = max(
            models[f"{run}: {form}"]["test"] / models[f"{run}: tf.function"]["test"] - 1
            for run in (study.cnn_lstm, study.unet)
        )
        harmless = lost <= EQUAL
        rows.append(
            (
                f"{form} is {says}",
                says,
                f"error changes by at most {100 * lost:+.1f} % of itself",
                REPRODUCED if harmless == (says == "harmless") else NOT,
            )
        )
    for run, title, paper in ((study.unet, "U-Net", 0.022), (study.cnn_lstm, "CNN-LSTM", 0.032)):
        fastest = min(
            (f for f in seconds if f.startswith(f"{run}: ")), key=lambda f: seconds[f]["p50"]
        )
        time = seconds[fastest]["p50"]
        rows.append(
            (
                f"Latency of the {title} on a CPU",
                f"{1e3 * paper:.0f} ms",
                f"{1e3 * seconds[f'{run}: tf.function']['p50']:.1f} ms as tf.function, {1e3 * time:.2f} ms as {fastest.split(': ')[1]}",
                "faster here" if time < paper else "slower here",
            )
        )
    rows += _pruning(study, models, seconds)
    return rows


def _by(gain):
    return f"{percent(abs(gain), 0)} % {'less' if gain > 0 else 'more'}"


def _gate(cnn, facts):
    """Whether the volume term, at the threshold that the CNN-LSTM was trained with, had anything to
    do."""
    opened = facts["train_gate_open"], cnn["gate_open"]
    found = f"beyond it: {percent(opened[0], 2)} % of the training samples, {percent(opened[1], 2)} % of the test frames; largest change {percent(max(cnn['violation']))} %"
    return (
        f"Answers leave the volume band of {percent(cnn['gate'], 0)} %, so that the term acts",
        "implied",
        found,
        REPRODUCED if all(opened) else PARTLY if any(opened) else NOT,
    )


def _physics(physics):
    """The arm of the volume term whose hard interactions gain most."""
    plain = physics[0]
    best = min(physics[1:], key=lambda arm: arm["hard"]["relative_l2"])
    gain = 1 - best["hard"]["relative_l2"] / plain["hard"]["relative_l2"]
    low, high = best["hard_difference"]["low"], best["hard_difference"]["high"]
    clear = high is not None and high < 0
    found = (
        f"{percent(plain['hard']['relative_l2'])} % without, {percent(best['hard']['relative_l2'])} % with ({best['label']}): difference"
        f" {percent(low)} to {percent(high)} points"
    )
    return (
        "The volume term errs less on unseen high forces",
        "by 8-30 %",
        found,
        (REPRODUCED if gain >= 0.08 else PARTLY) if clear else NOT,
    )


def _pruning(study, models, seconds):
    rows = []
    for run, title in ((study.cnn_lstm, "CNN-LSTM"), (study.unet, "U-Net")):
        base = f"{run}: float32"
        for kind, text in (("pruned", "zeros"), ("thin", "whole filters or units")):
            name = f"{run}_{kind}{100 * study.prune[0]:.0f}: float32"
            if name in models and name in seconds:
                faster = seconds[base]["p50"] / seconds[name]["p50"]
                worse = models[name]["test"] / models[base]["test"] - 1
                good = faster >= 1.3 and worse <= EQUAL
                found = f"{faster:.2f}x faster, error {100 * worse:+.1f} % of itself"
                rows.append(
                    (
                        f"{100 * study.prune[0]:.0f} % pruned by {text}: {title}",
                        "1.3x at equal error",
                        found,
                        REPRODUCED if good else PARTLY if faster >= 1.3 else NOT,
                    )
                )
    return rows
