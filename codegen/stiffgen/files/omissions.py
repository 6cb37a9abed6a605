# SPDX-License-Identifier: MIT
"""Find what a compiled MuJoCo model has and stiffgen does not read: arrays of the model that are not at their defaults.

The list follows from the model. A minimal model gives the default of each array, :class:`Recorded` notes the arrays
that the reader uses, and each other array with another value is an omission. Excluded are arrays that MuJoCo computes
from others, and settings of contacts, of the solver and of the display (``_WITHOUT_EFFECT``): an array that a later
MuJoCo adds is an omission until somebody reads or excludes it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

_DEFAULTS = """<mujoco><worldbody><body name="b"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint name="j"/>
</body></worldbody><tendon><fixed name="t"><joint joint="j" coef="1"/></fixed></tendon>
<equality><joint joint1="j"/></equality><actuator><motor joint="j"/></actuator></mujoco>"""
_KINDS = {"body": "bodies", "jnt": "joints", "dof": "joints", "tendon": "tendons", "actuator": "actuators"}
_WITHOUT_EFFECT = re.compile(
    r".*(adr|num|id|limited|user|group|rgba|width|margin|contype|conaffinity|solref\w*|solimp\w*)"
    r"|.*(M0|invweight0|acc0|length0|subtreemass|simple\w*|sameframe|dof_length|lengthrange|ctrlspec|history|actearly)"
    r"|tendon_type|tendon_lengthspring|actuator_trntype|actuator_outnum"
)
"""Indices, results of the compilation, contacts, solver, display; ``limited`` is true where a range is not its default.

A lag or a history of an actuator changes no bound of its force.
"""
_SOLVER = re.compile(r"(o_|ccd_|ls_|noslip_|sdf_|sleep_).*|.*flags|cone|impratio|integrator|iterations|jacobian|solver")
_NOT_MECHANICS = ("timestep", "tolerance", "magnetic", "disableactuator")
_UNUSED_FLAGS = (
    *("CONTACT", "FRICTIONLOSS", "LIMIT", "SPRING", "DAMPER", "CLAMPCTRL", "WARMSTART", "FILTERPARENT", "REFSAFE"),
    *("SENSOR", "MIDPHASE", "EULERDAMP", "AUTORESET", "NATIVECCD", "MULTICCD", "ISLAND", "EQUALITY", "CONSTRAINT"),
)
"""Flags that disable what no function contains, and those of constraints, which the reader follows."""
_STATES = 5


class Recorded:
    """A compiled model that notes which of its arrays are read."""

    def __init__(self, model: Any) -> None:
        self._model = model
        self.read: set[str] = set()

    def __getattr__(self, name: str) -> Any:
        self.read.add(name)
        return getattr(self._model, name)


def omissions(mujoco: Any, model: Any, read: set[str]) -> Iterator[dict[str, Any]]:
    """Yield the arrays that are not at their defaults and not ``read``: array, kind and names of the elements."""
    defaults = mujoco.MjModel.from_xml_string(_DEFAULTS)
    for array in dir(defaults):
        kind, _, name = array.partition("_")
        if kind not in _KINDS or not name or array in read or _WITHOUT_EFFECT.fullmatch(array):
            continue
        rows = np.asarray(getattr(model, array))
        default = np.asarray(getattr(defaults, array))[-1]
        first = 1 if kind == "body" else 0  # the world has no force
        changed = [k for k in range(first, len(rows)) if not np.array_equal(rows[k], default)]
        if changed:
            yield {"array": array, "kind": _KINDS[kind], "names": _names(model, kind, changed)}


def changed_options(mujoco: Any, model: Any) -> Iterator[str]:
    """Yield the physical options (gravity, a medium) that are not at their defaults, and what a flag disables."""
    for bit in mujoco.mjtDisableBit.__members__.values():
        flag = bit.name.removeprefix("mjDSBL_")
        if flag != bit.name and flag not in _UNUSED_FLAGS and int(model.opt.disableflags) & int(bit):
            yield f"the flag {flag.lower()} (disable)"
    default = mujoco.MjOption()
    for option in dir(default):
        if option.startswith("_") or option in _NOT_MECHANICS or _SOLVER.fullmatch(option):
            continue
        value, usual = np.atleast_1d(getattr(model.opt, option)), np.atleast_1d(getattr(default, option))
        if not np.allclose(value, usual, rtol=2e-3):  # 9.8 or 9.80665 instead of 9.81 is the same gravity
            yield f"{option} ({', '.join(f'{number:g}' for number in value)})"


def _names(model: Any, kind: str, rows: list[int]) -> list[str]:
    if kind == "dof":
        kind, rows = "jnt", list(dict.fromkeys(int(model.dof_jntid[k]) for k in rows))
    accessor = getattr(model, {"jnt": "joint"}.get(kind, kind))
    word = {"jnt": "joint"}.get(kind, kind)
    return [accessor(k).name or f"{word}{k}" for k in rows]


def forces_at_rest(mujoco: Any, model: Any) -> list[float]:
    """Return for each joint the largest force of springs, tendons and gravity compensation at rest, over some states.

    [N m or N]
    """
    data, random = mujoco.MjData(model), np.random.default_rng(46)
    largest = np.zeros(model.nv)
    scalar = [k for k in range(model.njnt) if int(model.jnt_type[k]) >= int(mujoco.mjtJoint.mjJNT_SLIDE)]
    for state in range(_STATES):
        data.qpos[:] = model.qpos0
        for k in scalar if state else ():
            low, high = model.jnt_range[k] if model.jnt_limited[k] else (-1.0, 1.0)
            data.qpos[model.jnt_qposadr[k]] = random.uniform(low, high)
        data.qvel[:] = 0
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        compensated = np.array([bool(model.jnt_actgravcomp[k]) for k in model.dof_jntid], dtype=bool)
        force = data.qfrc_passive + np.where(compensated, data.qfrc_gravcomp, 0.0)
        largest = np.maximum(largest, np.abs(force))
    return [float(largest[model.dof_jntid == k].max()) for k in range(model.njnt)]
