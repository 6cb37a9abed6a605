"""Structs of NAME_impedance.h as NumPy records: layouts, words of their choices, configuration, inputs and outputs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from enum import IntEnum, IntFlag
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _c


def layout(structure: str) -> np.dtype[Any]:
    """Return the layout of a C struct, which the compiler told."""
    rows = [row for row in _c.FIELDS if row[0] == structure]
    return np.dtype(
        {
            "names": [row[1] for row in rows],
            "formats": [(row[2], row[4]) for row in rows],
            "offsets": [row[3] for row in rows],
            "itemsize": _c.SIZES[structure],
        }
    )


CONFIG, INPUT, OUTPUT = map(layout, ("config", "input", "output"))
"""Layouts of the controller's structs."""
CONFIG_FIELDS, INPUT_FIELDS = CONFIG.names or (), INPUT.names or ()
"""Names of the fields of a configuration and of an input."""
WORDS: dict[str, dict[str, int]] = {}
"""Numbers of a field's words, by field."""
for _field, _word, _value in (*_c.CHOICES, *_c.OUTCOMES):
    WORDS.setdefault(_field, {})[_word] = _value


def of_shape(name: str, value: ArrayLike, shape: tuple[int, ...], *, one: bool = True) -> NDArray[np.float64]:
    """Return an argument's numbers; one number stands for all where that is allowed."""
    array = np.asarray(value, float)
    if array.shape != shape and not (one and array.ndim == 0):
        raise ValueError(f"{name}: shape {array.shape}, not {shape}")
    return np.array(np.broadcast_to(array, shape))


def enumeration(kind: Any, name: str, values: Mapping[str, int]) -> Any:
    """Return an enumeration of words, in capitals."""
    return kind(name, {word.upper(): value for word, value in values.items()})


Status = enumeration(IntFlag, "Status", {name: bit for name, bit, _ in _c.STATUSES})
"""Bits of a step's status."""
STATUS_MEANING = {Status(bit): meaning for _, bit, meaning in _c.STATUSES}
"""Meaning of each bit."""
Mode, Fault, Reason = (enumeration(IntEnum, field.capitalize(), WORDS[field]) for field in ("mode", "fault", "reason"))
"""Mode of a step, class of a latched fault, and reason for the fault."""
Refused = enumeration(IntEnum, "Refused", WORDS["refusal"])
"""Why a command is refused."""
COMMANDS = {value: word for word, value in WORDS["command"].items()}
"""Arguments that a refusal is about, by number."""
TYPES: dict[str, Any] = {"status": Status, "mode": Mode, "fault": Fault, "reason": Reason}


class Refusal(NamedTuple):
    """Refusal of a command: why, which argument and entry (joint, or row-major index), what was seen and its limit."""

    reason: IntEnum
    command: str
    entry: int
    seen: float
    limit: float
    text: str


def refusal_of(rows: NDArray[Any]) -> Refusal | None:
    """Return the refusal of a step's output, one row; None if nothing was refused."""
    row = rows[0]
    if not row["refusal"]:
        return None
    numbers = float(row["refusal_seen"]), float(row["refusal_limit"])
    command, text = COMMANDS[int(row["refusal_command"])], _c.refusal_text(np.ascontiguousarray(rows))
    return Refusal(Refused(int(row["refusal"])), command, int(row["refusal_entry"]), *numbers, text)


def _number(name: str, value: Any) -> Any:
    """Return the number of a word such as "release"; numbers pass."""
    if not isinstance(value, str):
        return value
    words = WORDS.get(name, {})
    if value not in words:
        known = f"it takes {', '.join(words)}" if words else "it takes numbers"
        raise ValueError(f"{name}: no value '{value}'; {known}")
    return words[value]


def _whole(name: str, number: NDArray[Any]) -> NDArray[Any]:
    """Return whole numbers that fit into a field: others are clipped, since they could wrap around into its range."""
    if not all(isinstance(each, int) for each in number.ravel().tolist()):
        raise ValueError(f"{name}: {number.tolist()!r} is no whole number")
    fitting = np.iinfo(CONFIG[name].base)
    clipped: NDArray[Any] = np.clip(number.astype(object), fitting.min, fitting.max)
    return clipped


def configuration(before: NDArray[Any] | None, values: Mapping[str, ArrayLike]) -> NDArray[Any]:
    """Return a configuration: another one, or the defaults, with some fields of other values.

    Raises TypeError for an unknown field, ValueError for a word or shape that a field does not take.
    """
    config = np.zeros(1, CONFIG) if before is None else before.copy()
    if before is None:
        _c.default_config(config)
    for name, value in values.items():
        if name not in CONFIG_FIELDS:
            raise TypeError(f"no configuration field '{name}'; there are: {', '.join(CONFIG_FIELDS)}")
        number = np.asarray(_number(name, value))
        shape = CONFIG[name].shape
        if number.ndim and number.shape != shape:
            raise ValueError(f"{name}: shape {number.shape}, not {shape} or one number")
        config[0][name] = _whole(name, number) if CONFIG[name].base.kind == "i" else number
    return config


def refused_configuration(code: int, config: NDArray[Any], stated: Mapping[str, Any]) -> str:
    """Return what a configuration that init refuses is told."""
    limits = [row[1] for row in _c.FIELDS if row[0] == "config" and row[1].endswith("_limit") and not row[5]]
    unstated = [name for name in limits if name not in stated and not np.isfinite(config[0][name]).all()]
    if unstated:
        return f"the robot's file lacks velocity or effort limits of joints; state {', '.join(unstated)}"
    return _c.error_text(code)


class Config:
    """Configuration of a controller: fields are attributes. A controller keeps its configuration."""

    __slots__ = ("_values",)
    _values: NDArray[Any]

    def __init__(self, values: NDArray[Any]) -> None:
        object.__setattr__(self, "_values", values)

    def __getattr__(self, name: str) -> Any:
        if name not in CONFIG_FIELDS:
            raise AttributeError(f"no configuration field '{name}'; there are: {', '.join(CONFIG_FIELDS)}")
        value = self._values[0][name].copy()
        words = {number: word for word, number in WORDS.get(name, {}).items()}
        return words.get(int(value), int(value)) if words else value

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{name}: a controller keeps its configuration; restart(torque, {name}=...) takes another")

    def __reduce__(self) -> tuple[Any, ...]:
        return Config, (self._values,)

    def __iter__(self) -> Iterator[str]:
        return iter(CONFIG_FIELDS)

    def __dir__(self) -> list[str]:
        return list(CONFIG_FIELDS)

    def __repr__(self) -> str:
        return _listing("Config", {name: getattr(self, name) for name in self})


def _listing(title: str, values: Mapping[str, Any]) -> str:
    """Return the values line by line below a title, with names in a column of equal width."""
    width = max(len(name) for name in values)
    indent = " " * (width + 7)

    def text(value: Any) -> str:
        if isinstance(value, (IntEnum, IntFlag)):
            return value.name or str(value)
        if value is None or isinstance(value, Refusal):
            return value.text if value else "None"
        return np.array2string(np.asarray(value), precision=4, suppress_small=True).replace("\n", "\n" + indent)

    return "\n".join([title, *(f"    {name:{width}} = {text(value)}" for name, value in values.items())])


class Record:
    """Inputs or outputs of one step, or of several with a leading time axis; fields are attributes and keys."""

    __slots__ = ("_rows", "_single")

    def __init__(self, rows: NDArray[Any], single: bool = False) -> None:
        self._rows, self._single = rows, single

    def __reduce__(self) -> tuple[Any, ...]:
        return Record, (self._rows, self._single)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fields."""
        return self._rows.dtype.names or ()

    def __getattr__(self, name: str) -> Any:
        """Return a field of the record; of a single step its value, of several their column."""
        if name.startswith("_") or name not in self.names:
            raise AttributeError(f"no field '{name}'; there are: {', '.join(self.names)}")
        if not self._single:
            return self._rows[name]
        if name == "refusal":
            return refusal_of(self._rows)
        value = self._rows[name][0]
        return TYPES[name](int(value)) if name in TYPES else value

    __getitem__ = __getattr__

    @property
    def text(self) -> str:
        """Mode, fault with its numbers, and status bits in words; of several steps, those of the last one."""
        row = self._rows[-1:]
        if not len(row) or "status" not in self.names:
            return ""
        fault, refusal, bits = Fault(int(row["fault"][0])), refusal_of(row), int(row["status"][0])
        lines = [f"mode {Mode(int(row['mode'][0])).name}"]
        if fault:
            reason = Reason(int(row["reason"][0])).name
            lines.append(f"fault {fault.name}, {reason}: {_c.fault_text(np.ascontiguousarray(row))}")
        if refusal:
            lines.append(f"refused: {refusal.text}")
        lines += [f"{bit.name}: {meaning}" for bit, meaning in STATUS_MEANING.items() if bits & bit]
        return "\n".join(lines)

    def __len__(self) -> int:
        return len(self._rows)

    def __dir__(self) -> list[str]:
        return [*self.names, "names", "text"]

    def __repr__(self) -> str:
        if not self._single:
            return f"Record of {len(self)} steps: {', '.join(self.names)}"
        return _listing("Record", {name: getattr(self, name) for name in self.names})
