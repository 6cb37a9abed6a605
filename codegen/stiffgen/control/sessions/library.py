# SPDX-License-Identifier: MIT
"""Call the C controller of a folder through the table of its fields, without the folder's Python."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stiffgen.control.companions import COMPANIONS
from stiffgen.control.core.config import CONFIG
from stiffgen.control.core.field import Field
from stiffgen.control.core.signals import INPUT, OUTPUT
from stiffgen.control.structs import present, sizes_of
from stiffgen.core.emit.build import build_library
from stiffgen.core.errors import BuildError
from stiffgen.core.robot.chain import Chain

_STATED: dict[str, float] = {"sample_time": 1e-3, "delay_samples": 0, "motor_inertia": 0.3, "heaviest_wrench": 50.0}
"""Values of the fields without a default, for every entry."""
_STATE_SIZE = 1 << 19
"""Bytes of memory for a state: more than the largest robot needs."""
_TYPES: dict[str, Any] = {"double": ctypes.c_double, "int": ctypes.c_int, "uint32_t": ctypes.c_uint32}


def config_fields(chain: Chain, *, bounded: bool) -> tuple[Field, ...]:
    """Return the fields that a robot's configuration has; ``bounded`` tells whether it has the bounded spring."""
    return present(CONFIG, chain, bounded=bounded)


def value_without_default(field: Field) -> float:
    """Return a value for every entry of a field that has no default, or whose default the robot's file lacks."""
    return _STATED.get(field.name, 20.0)


def struct_of(chain: Chain, name: str, fields: Sequence[Field], pairs: int = 0) -> type[ctypes.Structure]:
    """Return the layout of a C struct of the controller of a robot with some pairs of tips."""
    members = []
    for field in fields:
        count = math.prod(extent_of(chain, extent, pairs) for extent in field.shape)
        members.append((field.name, _TYPES[field.type] * count if field.shape else _TYPES[field.type]))
    return type(name, (ctypes.Structure,), {"_fields_": members})


def extent_of(chain: Chain, extent: int | str, pairs: int = 0) -> int:
    """Return a fixed extent, or one with a name."""
    return sizes_of(chain, pairs)[extent] if isinstance(extent, str) else extent


CAREFUL = ("-O1", "-fsanitize=bounds", "-fsanitize-undefined-trap-on-error", "-ftrivial-auto-var-init=pattern")
"""Flags of gcc and clang: an index outside an array ends the process, and locals start with a fixed pattern."""


def build_controller(folder: Path, name: str, build: Path) -> Path:
    """Compile kernels, controller and companions in a folder into a shared library in the new folder ``build``.

    A compiler that refuses :data:`CAREFUL` compiles without these flags.
    """
    build.mkdir(parents=True)
    parts = (folder.resolve() / f"{name}_{part}.c" for part in ("impedance", *COMPANIONS))
    controller = [part for part in parts if part.exists()]
    try:
        return build_library(folder, name, build, CAREFUL, more=controller)
    except BuildError:
        return build_library(folder, name, build, more=controller)


class ControllerLibrary:
    """Compiled controller with a configuration, a state, an input and an output."""

    def __init__(self, file: Path, name: str, chain: Chain, *, bounded: bool = False, pairs: int = 0) -> None:
        """Load the compiled controller, build its records, and find the size of its state."""
        self._library = ctypes.CDLL(str(file))
        self._prefix, self.fields = f"{name}_impedance_", config_fields(chain, bounded=bounded)
        self.config = struct_of(chain, "Config", self.fields)()
        self.input = struct_of(chain, "Input", INPUT, pairs)()
        self.output = struct_of(chain, "Output", OUTPUT)()
        self.state = (ctypes.c_double * (_STATE_SIZE // 8))()
        self.take_defaults()  # before the size is found: init needs a configuration
        self.state_size = self._find_state_size()

    def take_defaults(self) -> None:
        """Take the default of every field, and some value where there is none; a robot's file may lack limits, too."""
        self.call("default_config", self.config)
        for field in self.fields:
            values = np.ravel(getattr(self.config, field.name))
            if not all(field.least <= value <= field.most for value in values):  # nor NaN
                set_field(self.config, field, value_without_default(field), -1)

    def call(self, function: str, *arguments: Any) -> int:
        """Call a function; structs and arrays are passed by address, doubles by value, None as a null pointer."""
        passed = [
            each if each is None or isinstance(each, ctypes.c_double) else ctypes.byref(each) for each in arguments
        ]
        return int(getattr(self._library, self._prefix + function)(*passed))

    def _find_state_size(self) -> int:
        """Return the size of a state [bytes]: init writes all of it. All memory where init fails."""
        ctypes.memset(self.state, 0xFF, _STATE_SIZE)
        failed = self.call("init", self.config, self.state, None)
        doubles = -(-len(bytes(self.state).rstrip(b"\xff")) // 8)
        ctypes.memset(self.state, 0, _STATE_SIZE)
        return _STATE_SIZE if failed else 8 * doubles

    def error_text(self, error: int) -> bytes:
        """Return the text of an error code."""
        function = self._library[self._prefix + "error_text"]
        function.restype = ctypes.c_char_p
        return bytes(function(error) or b"")

    def fault_text(self, size: int) -> tuple[int, bytes]:
        """Return the length of the text of the output's fault, and the text as it stands in ``size`` bytes."""
        text = ctypes.create_string_buffer(b"~" * 600)
        length = self._library[self._prefix + "fault_text"](ctypes.byref(self.output), text, ctypes.c_size_t(size))
        return int(length), text.raw

    def refusal_text(self, size: int) -> tuple[int, bytes]:
        """Return the length of the text of the output's refusal, and the text as it stands in ``size`` bytes."""
        text = ctypes.create_string_buffer(b"~" * 600)
        length = self._library[self._prefix + "refusal_text"](ctypes.byref(self.output), text, ctypes.c_size_t(size))
        return int(length), text.raw


def is_same(reference: ControllerLibrary, library: ControllerLibrary) -> bool:
    """Return whether the outputs and the states of two controllers have the same bits."""
    states = (ctypes.string_at(each.state, reference.state_size) for each in (reference, library))
    return bytes(reference.output) == bytes(library.output) and next(states) == next(states)


def set_field(config: Any, field: Field, value: float, entry: int) -> None:
    """Set a field of a configuration, or one entry of a field with a shape (all for -1).

    An int takes the nearest value of its 32 bits, and the least one for NaN and infinity.
    """
    if field.type == "int":
        value = int(max(min(value, 2**31 - 1), -(2**31))) if math.isfinite(value) else -(2**31)
    if not field.shape:
        setattr(config, field.name, value)
        return
    values = getattr(config, field.name)
    for place in range(len(values)) if entry < 0 else [entry % len(values)]:
        values[place] = value


def fill(array: Any, values: Any) -> None:
    """Write numbers into an array of a struct."""
    array[:] = np.asarray(values).ravel().tolist()[: len(array)]
