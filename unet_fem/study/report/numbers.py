"""How the page writes numbers."""

from unet_fem.networks.registry import Options


def percent(share: float | None, digits: int = 1) -> str:
    """A share in %, "-" for None."""
    return "-" if share is None else f"{100 * share:.{digits}f}"


def milliseconds(seconds: float | None, digits: int | None = None) -> str:
    """Seconds in ms, to three figures or to so many digits, "-" for None."""
    if seconds is None:
        return "-"
    return f"{1e3 * seconds:.3g}" if digits is None else f"{1e3 * seconds:.{digits}f}"


def interval(found: dict, digits: int = 1) -> str:
    """A relative L2 with its interval in %, see statistics.interval."""
    return _between(found["relative_l2"], found["low"], found["high"], digits)


def median(found: dict, digits: int = 1) -> str:
    """The median over interactions with its interval in %, see statistics.errors."""
    return _between(found["median"], found["median_low"], found["median_high"], digits)


def _between(own, low, high, digits):
    shown = percent(own, digits)
    return shown if low is None else f"{shown} ({percent(low, digits)} to {percent(high, digits)})"


def difference(found: dict | None) -> str:
    """A difference of errors with its interval in points, see statistics.difference."""
    if found is None:
        return "-"
    own = f"{100 * found['difference']:+.1f}"
    if found["low"] is None:
        return own
    return f"{own} ({100 * found['low']:+.1f} to {100 * found['high']:+.1f})"


def options_label(model: Options) -> str:
    """The settings of a kind of model in words, as "512 units, 2 steps"."""
    return ", ".join(
        f"{value} {name.removesuffix('s') if value == 1 else name}"
        for name, value in model.own().items()
    )


def options_tuple(model: Options) -> str:
    """Their values alone, as "(512, 2)"."""
    return f"({', '.join(map(str, model.own().values()))})"


def figures(share: float, count: int) -> str:
    """A share in %, to so many figures."""
    return f"{100 * share:.{count}g}"


def given(value: object, form: str = "%s") -> str:
    """A value in printf's `form`, "-" for None."""
    text = "-" if value is None else form % value
    return text.lstrip("-") if text.strip("-0.") == "" and "0" in text else text  # no -0.00
