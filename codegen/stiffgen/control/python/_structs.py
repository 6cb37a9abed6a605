"""Structs of NAME_impedance.h as NumPy records: layouts, words of their choices, configuration, inputs and outputs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from enum import IntEnum, IntFlag
from inspect import Parameter, signature
from typing import Any

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


CONFIG, INPUT, OUTPUT, PROPOSAL, POLICY = map(layout, ("config", "input", "output", "proposal", "policy"))
"""Layouts of the controller's structs."""
CONFIG_FIELDS, INPUT_FIELDS = CONFIG.names or (), INPUT.names or ()
"""Names of the fields of a configuration and of an input."""
WORDS: dict[str, dict[str, int]] = {}
"""Numbers of a field's words, by field."""
for _field, _word, _value in (*_c.CHOICES, *_c.OUTCOMES):
    WORDS.setdefault(_field, {})[_word] = _value


def _enumeration(kind: Any, field: str, values: Mapping[str, int]) -> Any:
    return kind(field.capitalize(), {word.upper(): value for word, value in values.items()})


Status = _enumeration(IntFlag, "status", {name: bit for name, bit, _ in _c.STATUSES})
"""Bits of a step's status."""
STATUS_MEANING = {Status(bit): meaning for _, bit, meaning in _c.STATUSES}
"""Meaning of each bit."""
Mode, Fault, Reason = (_enumeration(IntEnum, field, WORDS[field]) for field in ("mode", "fault", "reason"))
"""Mode of a step, class of a latched fault, and reason for the fault."""
Refusal, Refused, Stage = (_enumeration(IntEnum, field, WORDS[field]) for field in ("refusal", "refused", "stage"))
"""Why a command is refused; why the policy port refuses a part, and the stage of a part."""
PARTS = tuple(WORDS["part"])
"""Parts of a proposal, in the order of their arrays."""
TYPES: dict[str, Any] = {"status": Status, "mode": Mode, "fault": Fault, "reason": Reason, "refusal": Refusal}
DERIVED = ("tank_initial", "engagement_limit", "energy_limit")
"""Energies that follow from heaviest_wrench where the configuration has 0; an output has those in force."""
REFUSAL = ("refusal", "refusal_argument", "refusal_entry", "refusal_seen", "refusal_limit")


def refusal_text(row: Any) -> str:
    """Return a refusal of a step's output, or of a part of the port, in words."""
    text: str = _c.refusal_text(*(row[name].item() for name in REFUSAL))
    return text


def _number(name: str, value: Any) -> Any:
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


class Config:
    """Configuration of a controller. Fields are attributes; a value is checked, and stored only if it is valid.

    Arrays are read-only copies: assign a whole field, ``config.velocity_limit = limits``.

    The next step uses a change; torques stay within their rate limit.
    """

    __slots__ = ("_values",)
    _values: NDArray[Any]

    def __init__(self) -> None:
        object.__setattr__(self, "_values", np.zeros(1, CONFIG))
        _c.default_config(self._values)

    def __getattr__(self, name: str) -> Any:
        if name not in CONFIG_FIELDS:
            raise AttributeError(_unknown(name))
        value = self._values[0][name].copy()
        if isinstance(value, np.ndarray):
            value.flags.writeable = False  # an entry that is set here would be lost
        words = {number: word for word, number in WORDS.get(name, {}).items()}
        return words.get(int(value), int(value)) if words else value

    def __setattr__(self, name: str, value: ArrayLike) -> None:
        if name not in CONFIG_FIELDS:
            raise AttributeError(_unknown(name))
        self.update({name: value})

    def update(self, values: Mapping[str, ArrayLike]) -> None:
        """Set several fields at once, all or none, for values that are valid only together."""
        trial = self._values.copy()
        for name, value in values.items():
            if name not in CONFIG_FIELDS:
                raise TypeError(_unknown(name))
            number = np.asarray(_number(name, value))
            shape = CONFIG[name].shape
            if number.ndim and number.shape != shape:
                raise ValueError(f"{name}: shape {number.shape}, not {shape} or one number")
            trial[0][name] = _whole(name, number) if CONFIG[name].base.kind == "i" else number
        code = _c.validate(trial)
        if code:
            limits = [row[1] for row in _c.FIELDS if row[0] == "config" and not row[5] and row[1] not in values]
            unstated = [name for name in limits if not np.isfinite(trial[0][name]).all()]
            if unstated:
                raise ValueError(
                    f"the robot's file lacks velocity or effort limits of joints; set {', '.join(unstated)}"
                )
            raise ValueError(_c.error_text(code))
        self._values[:] = trial

    def describe(self, output: Any = None) -> str:
        """Return all fields as text, by section, with their units; a star marks what differs from the default.

        ``output`` of a step has what a controller derives where an energy is 0: :meth:`Impedance.describe`.
        """
        fresh, lines = Config(), []
        for _, name, _, _, _, _, unit, heading in (row for row in _c.FIELDS if row[0] == "config"):
            lines += ["", heading] if heading else []
            value = getattr(self, name)
            words = [value if isinstance(value, str) else _numbers(np.asarray(value)), unit.removeprefix("1")]
            if output is not None and name in DERIVED and not np.any(value) and output[name] > 0.0:
                words.append(f"({output[name]:.4g} follows)")
            mark = "*" if np.any(value != getattr(fresh, name)) else " "
            lines.append(f"{mark} {name:<28} {' '.join(filter(None, words))}")
        return "\n".join(lines[1:])

    def __getstate__(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self}

    def __setstate__(self, values: Mapping[str, ArrayLike]) -> None:
        self.__init__()  # type: ignore[misc]
        self.update(values)

    def __dir__(self) -> list[str]:
        return [*CONFIG_FIELDS, "describe", "update"]

    def __iter__(self) -> Iterator[str]:
        return iter(CONFIG_FIELDS)

    def __repr__(self) -> str:
        return _listing("Config", {name: getattr(self, name) for name in self})


def allowed_stiffness(values: NDArray[Any]) -> str:
    """Return which stiffness limits would be accepted, for a configuration that init refuses for them; else nothing."""
    trial, state, torque = values.copy(), np.zeros((_c.SIZES["state"] + 7) // 8), np.zeros(_c.MOTORS)
    limits = {"translation_stiffness_limit": (1.0, "N/m"), "rotation_stiffness_limit": (0.1, "N m/rad")}

    def accepts(**changed: float) -> bool:
        for name, (least, _) in limits.items():
            trial[0][name] = changed.get(name, least)
        return bool(_c.initialise(trial, state, torque) == 0)

    if _c.validate(values) or not accepts():
        return ""
    found = []
    for name, (low, unit) in limits.items():
        high = float(values[0][name])
        if accepts(**{name: high}):
            low = high
        while high - low > 1e-3 * high:
            middle = (low + high) / 2
            low, high = (middle, high) if accepts(**{name: middle}) else (low, middle)
        digit = 10.0 ** np.floor(np.log10(low) - 1)  # two digits, rounded down
        found.append(f"{np.floor(low / digit + 1e-9) * digit:g} {unit}")
    rate, delay = 1 / float(values[0]["sample_time"]), int(values[0]["delay_samples"])
    return f" (at {rate:.0f} Hz and delay_samples {delay} at most {' and '.join(found)})"


def tell_tool(step: Any, inputs: Sequence[str]) -> None:
    """Set a step's signature: ``tool_pose`` is required where it is among the inputs, and unknown elsewhere."""
    told = signature(step)
    parameters = dict(told.parameters)
    if "tool_pose" in inputs:
        parameters["tool_pose"] = parameters["tool_pose"].replace(default=Parameter.empty, annotation="ArrayLike")
    else:
        del parameters["tool_pose"]
    step.__signature__ = told.replace(parameters=list(parameters.values()))


def check_inputs(step: Any, values: Mapping[str, Any], inputs: Sequence[str], needed: Sequence[str]) -> None:
    """Raise TypeError where a step has a ``tool_pose`` that is none of its inputs, or lacks what it needs."""
    if "tool_pose" in values and "tool_pose" not in inputs:
        raise TypeError(f"{step.__qualname__}() got an unexpected keyword argument 'tool_pose'")
    missing = [name for name in needed if name not in values]
    if missing:
        raise TypeError(f"a step needs {', '.join(missing)}")


def _numbers(value: NDArray[Any]) -> str:
    """Return a number, or the numbers of an array once if they are equal."""
    entries = [f"{entry:.6g}" for entry in value.ravel()]
    equal = len(set(entries)) == 1
    return entries[0] if equal else f"[{', '.join(entries)}]"


def _unknown(name: str) -> str:
    return f"no configuration field '{name}'; there are: {', '.join(CONFIG_FIELDS)}"


def _listing(title: str, values: Mapping[str, Any]) -> str:
    width = max(len(name) for name in values)
    indent = " " * (width + 7)

    def text(value: Any) -> str:
        if isinstance(value, (IntEnum, IntFlag)):
            return value.name or str(value)
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
        if name.startswith("_") or name not in self.names:
            raise AttributeError(f"no field '{name}'; there are: {', '.join(self.names)}")
        if not self._single:
            return self._rows[name]
        value = self._rows[name][0]
        return TYPES[name](int(value)) if name in TYPES else value

    __getitem__ = __getattr__

    @property
    def text(self) -> str:
        """Mode, fault with its numbers, and status bits in words; of several steps, those of the last one."""
        row = self._rows[-1:]
        if not len(row) or "status" not in self.names:
            return ""
        fault = Fault(int(row["fault"][0]))
        lines = [f"mode {Mode(int(row['mode'][0])).name}"]
        if fault:
            reason = Reason(int(row["reason"][0])).name
            lines.append(f"fault {fault.name}, {reason}: {_c.fault_text(np.ascontiguousarray(row))}")
        bits = int(row["status"][0])
        if int(row["refusal"][0]):
            lines.append(f"refused: {refusal_text(row[0])}")
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
