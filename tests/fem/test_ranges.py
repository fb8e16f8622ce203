"""Every number of every settings table has a range, and the messages come from it."""

import dataclasses
import math
import typing

import numpy as np
import pytest

from fem.contact.draw import ContactRange
from fem.contact.push import Push
from fem.data.mesh_choice import MeshChoice
from fem.data.scene import Frames, Health, Interactions, SolverChoice
from fem.errors import InputError
from fem.material.kinds import KINDS
from fem.ranges import KEY, Range, check, check_fields, number, numbers
from fem.settings import build
from fem.solver.frame_loop import LoopSettings
from unet_fem.networks.registry import NETWORKS
from unet_fem.study import settings as study
from unet_fem.training.settings import LossChoice, TrainChoice

TABLES = [
    ContactRange, Push, MeshChoice, Frames, Health, Interactions, SolverChoice, LoopSettings,
    LossChoice, TrainChoice, *KINDS.values(), *(row.options for row in NETWORKS.values()),
    study.Main, study.Order, study.Fem, study.Stability, study.Study,
]  # fmt: skip
FREE = {(Push, "at"), (Push, "direction")}  # any place and any direction: finite is enough


def holds_numbers(hint):
    """Whether a value of this type has numbers in it that are no settings of their own."""
    if hint in (int, float, np.ndarray):
        return True
    return any(holds_numbers(part) for part in typing.get_args(hint))


def number_fields(table):
    hints = typing.get_type_hints(table)
    return [f for f in dataclasses.fields(table) if f.init and holds_numbers(hints[f.name])]


def test_every_number_of_every_table_has_a_range():
    bare = {(t, f.name) for t in TABLES for f in number_fields(t) if KEY not in f.metadata}
    assert bare == FREE


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.__name__)
def test_defaults_lie_in_their_ranges(table):
    for field in number_fields(table):
        if KEY in field.metadata and field.default not in (dataclasses.MISSING, None):
            check(field.name, field.default, field.metadata[KEY])


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, -1e301, 1e301])
@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.__name__)
def test_no_table_takes_nonsense_from_a_file(table, bad):
    """Each number alone, with the key, the value and the range in one line."""
    hints = typing.get_type_hints(table)
    for field in number_fields(table):
        sizes = [len(a) for a in map(typing.get_args, [hints[field.name]]) if ... not in a] or [1]
        value = bad
        if "tuple" in str(hints[field.name]):
            value = [bad] * (2 if "], ..." in str(hints[field.name]) else max(sizes))
            value = [value] if "tuple[tuple" in str(hints[field.name]) else value
        with pytest.raises(InputError) as error:
            build(table, {field.name: value}, "table")
        assert f"table.{field.name}" in str(error.value) and "\n" not in str(error.value)


@dataclasses.dataclass(frozen=True)
class Table:
    share: float = number(0, 1, default=0.5)
    pair: tuple[float, float] = number(0, 9, "m", ascending=True, default=(1.0, 2.0))
    many: tuple[float, ...] = number(0, 9, default=())
    rows: tuple[tuple[float, float], ...] = numbers(Range(0, 1), Range(1, math.inf), default=())
    free: float = 0.0


@pytest.mark.parametrize(
    "values, message",
    [
        ({"share": 1.5}, "t.share = 1.5 must be from 0 to 1"),
        ({"share": math.nan}, "t.share = nan must be from 0 to 1"),
        ({"pair": (1.0, 10.0)}, "t.pair = [1.0, 10.0] must be numbers from 0 to 9 m"),
        ({"pair": (2.0, 1.0)}, "t.pair = [2.0, 1.0] must be numbers from low to high"),
        ({"many": (1.0, 2.0, 3.0, 4.0, 10.0)}, "t.many[4] = 10.0 must be from 0 to 9"),
        ({"rows": ((0.5, 2.0), (0.5, 0.0))}, "t.rows[1] = [0.5, 0.0] must have number 2 at least"),
        ({"free": math.inf}, "t.free = inf must be from -1e+15 to 1e+15"),
    ],
)
def test_messages_name_key_value_and_range(values, message):
    with pytest.raises(InputError) as error:
        check_fields(Table(**values), "t")
    assert message in str(error.value)
    check_fields(Table(), "t")


def test_arrays_are_checked_whole_and_named_by_place():
    check("mu", np.full(1000, 3.0), Range(0, 9))
    with pytest.raises(InputError, match=r"mu\[7\] = nan must be from 0 to 9"):
        check("mu", np.where(np.arange(1000) == 7, np.nan, 3.0), Range(0, 9))
