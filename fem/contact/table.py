"""Contacts as rows of an array, for files."""

from collections.abc import Sequence

import numpy as np

from fem.contact.push import Contact

TABLE = np.dtype(
    [
        ("start", "f8", 3),
        ("end", "f8", 3),
        ("direction", "f8", 3),
        ("radius", "f8"),
        ("peak", "f8"),
        ("onset", "f8"),
        ("ramp", "f8"),
        ("hold", "f8"),
        ("pattern", "S10"),
        ("low", "f8"),
        ("rate", "f8"),
        ("duration", "f8"),
    ]
)
COLUMNS = TABLE.names or ()


def contact_table(contacts: Sequence[Contact]) -> np.ndarray:
    """(C,) rows of TABLE."""
    return np.array(
        [tuple(getattr(contact, name) for name in COLUMNS) for contact in contacts], TABLE
    )


def table_contacts(table: np.ndarray) -> list[Contact]:
    """The contacts behind rows (C,) of TABLE, to the bit."""
    return [
        Contact(**dict(zip(COLUMNS, row, strict=True)) | {"pattern": row["pattern"].decode()})
        for row in table
    ]
