# SPDX-License-Identifier: MIT
"""Compile one MJCF file with MuJoCo, as a script in a process of its own: ``python compilation.py < request.json``.

MuJoCo resolves defaults, classes, includes, attachments and the compiler's settings. Before it compiles, the script
removes what kinematics and masses do not need, so that missing meshes and textures do not matter: textures, materials,
sensors, cameras, and the geoms of bodies whose inertia the file states. No part is removed while another one that
stays names it: geoms that a tendon wraps stay, and tendons, geoms and sites lose their materials. A body that the file
would fuse with its parent unless a sensor names it stays, too. A geom that gives a body its inertia stays; if its mesh
is missing, a small sphere stands in, and the answer names the body. If MuJoCo refuses what is left, the script compiles
the file as it is, so that an error is the file's own. Of stiffgen the script imports modules of this folder alone.

The request holds ``file``. The answer is JSON on standard output: ``model`` (name, bodies, joints, sites, couplings,
loops, actuators, omissions), ``files`` (path and SHA-256 of each file read beside the main one) and ``stand_ins`` (body
and mesh); or ``error``, ``refusal``, ``encoding``.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from stiffgen.core.robot.files import FileError
from stiffgen.files.actuation import actuation, tendon_joints
from stiffgen.files.limits import limit_process
from stiffgen.files.omissions import Recorded, changed_options, forces_at_rest, omissions
from stiffgen.files.repeats import check_parts

SECONDS = 60
"""Processor time that a compilation may take; the largest known model takes 4 s."""
_GIBIBYTES = 8  # MuJoCo reserves more address space than memory
_MOST_FILES = 1000
"""Files that a model may consist of."""
_STAND_IN_RADIUS = 0.01
"""[m] Radius of the sphere in place of a missing mesh."""
_UNUSED = (
    *("sensors", "cameras", "lights", "keys", "numerics", "texts", "tuples", "pairs", "excludes"),
    *("skins", "flexes", "hfields", "materials", "textures"),
)


def _compiled(file: Path) -> dict[str, Any]:
    """Return the answer for a file."""
    import mujoco

    check_parts(file, _MOST_FILES)
    model, spec, used, stand_ins = _model(mujoco, file)
    name = spec.modelname
    files = {str(each): hashlib.sha256(each.read_bytes()).hexdigest() for each in (*_includes(file), *used)}
    files.pop(str(file), None)
    return {
        "model": {
            "name": file.stem if name in ("", "MuJoCo Model") else name,
            **_content(mujoco, model),
        },
        "files": sorted(files.items()),
        "stand_ins": stand_ins,
    }


def _model(mujoco: Any, file: Path) -> tuple[Any, Any, list[Path], list[tuple[str, str]]]:
    """Return model, specification, meshes used and stand-ins of a file.

    If MuJoCo cannot read a mesh, a second attempt takes all of them for missing. The last one compiles the file as it
    is. Its error is raised, unless it is about a mesh: then the first attempt's.
    """
    first: ValueError | None = None
    for all_missing in (False, True):
        spec = mujoco.MjSpec.from_file(str(file))
        used, stand_ins = _strip(mujoco, spec, all_missing=all_missing)
        try:
            return spec.compile(), spec, used, stand_ins
        except ValueError as error:
            first = first or error
            if not used or not _names_mesh(error):  # else a mesh that MuJoCo cannot read: without any
                break
    try:
        spec = mujoco.MjSpec.from_file(str(file))
        return spec.compile(), spec, [], []
    except ValueError as error:
        raise (first or error) if _names_mesh(error) else error from None


def _names_mesh(error: ValueError) -> bool:
    return "mesh" in str(error).lower() or "resource" in str(error).lower()


def _strip(mujoco: Any, spec: Any, all_missing: bool) -> tuple[list[Path], list[tuple[str, str]]]:
    """Remove what has no effect; return the meshes that give inertias, and the bodies with a stand-in for one."""
    for kind in _UNUSED:
        for element in list(getattr(spec, kind)):
            spec.delete(element)
    spec.compiler.fusestatic = False
    kept = (mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtEq.mjEQ_TENDON, mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)
    for equality in list(spec.equalities):
        if equality.type not in kept:
            spec.delete(equality)
    meshes = {mesh.name: mesh for mesh in spec.meshes}
    used, stand_ins = _keep_inertias(mujoco, spec, meshes, all_missing)
    for site in spec.sites:
        site.material = ""
        if site.meshname:
            site.type, site.meshname = mujoco.mjtGeom.mjGEOM_SPHERE, ""
    for tendon in spec.tendons:
        tendon.material = ""
    for name, mesh in meshes.items():
        if name not in used:
            spec.delete(mesh)
    return [path for paths in used.values() for path in paths], stand_ins


def _keep_inertias(
    mujoco: Any, spec: Any, meshes: Mapping[str, Any], all_missing: bool
) -> tuple[dict[str, list[Path]], list[tuple[str, str]]]:
    """Remove the geoms that give no inertia and guide no tendon.

    Returns:
        The meshes that stay, with their files (none if the vertices stand in the model's file), and the bodies with a
        stand-in for a mesh, each with the mesh's file.

    """
    wrapped = _wrapped_geoms(spec)
    used: dict[str, list[Path]] = {}
    stand_ins = []
    for body, geom in [(each, geom) for each in spec.bodies for geom in each.geoms]:
        gives_inertia = _gives_inertia(mujoco, spec, body, geom)
        if not gives_inertia and geom.name not in wrapped:
            spec.delete(geom)
            continue
        geom.material = ""
        mesh = meshes.get(geom.meshname)  # None if the geom names a mesh that does not exist: MuJoCo says so
        if not gives_inertia or not geom.meshname or mesh is None:
            continue
        files = _mesh_files(spec, mesh) if mesh.file and not all_missing else []
        if files or not mesh.file:
            used.setdefault(mesh.name, files)
        else:
            geom.type, geom.meshname, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, "", [_STAND_IN_RADIUS, 0, 0]
            stand_ins.append((body.name, mesh.file))
    return used, stand_ins


def _wrapped_geoms(spec: Any) -> set[str]:
    """Return the names of the geoms that spatial tendons wrap."""
    targets = (wrap.target for tendon in spec.tendons for wrap in tendon.path)
    return {target.name for target in targets if target is not None and target.name}


def _gives_inertia(mujoco: Any, spec: Any, body: Any, geom: Any) -> bool:
    """Return whether a geom is part of the inertia of its body."""
    compiler = spec.compiler
    rule = mujoco.mjtInertiaFromGeom
    low, high = compiler.inertiagrouprange
    if body.name == "world" or geom.type in (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD):
        return False
    if compiler.inertiafromgeom == rule.mjINERTIAFROMGEOM_FALSE or not low <= geom.group <= high:
        return False
    return bool(compiler.inertiafromgeom == rule.mjINERTIAFROMGEOM_TRUE or not body.explicitinertial)


def _mesh_files(spec: Any, mesh: Any) -> list[Path]:
    """Return the file of a mesh where it exists."""
    root, name = Path(spec.modelfiledir or "."), Path(mesh.file)
    places = (root / (spec.compiler.meshdir or "") / name, root / name, name)
    return [place for place in places if place.is_file()][:1]


def _includes(file: Path) -> Iterator[Path]:
    """Yield the files that a file includes or attaches, each once; a missing file is MuJoCo's to name."""
    pending, seen = [file], {file}
    while pending and len(seen) < _MOST_FILES:
        current = pending.pop()
        try:
            root = ElementTree.fromstring(current.read_bytes())
        except (ElementTree.ParseError, OSError):
            continue
        for element in (*root.iter("include"), *root.iter("model")):
            name = element.get("file")
            places = [folder / name for folder in (file.parent, current.parent)] if name else []
            found = next((Path(os.path.normpath(place)) for place in places if place.is_file()), None)
            if found is not None and found not in seen:
                seen.add(found)
                pending.append(found)
                yield found


def _content(mujoco: Any, compiled: Any) -> dict[str, Any]:
    """Return the compiled model's kinematics and masses as plain numbers, and what it has beside them."""
    model = Recorded(compiled)
    content = {
        **_tree(mujoco, model),
        "couplings": list(_couplings(mujoco, model)),
        "loops": list(_loops(mujoco, model)),
        "actuation": actuation(mujoco, model),
    }
    return content | {
        "omissions": list(omissions(mujoco, compiled, model.read)),
        "options": list(changed_options(mujoco, compiled)),
        "at_rest": forces_at_rest(mujoco, compiled),
    }


def _tree(mujoco: Any, model: Any) -> dict[str, Any]:
    """Return bodies, joints and sites of MuJoCo's compiled model, as JSON can carry them; lengths in m, angles in
    rad.
    """
    joint_types = {
        mujoco.mjtJoint.mjJNT_FREE: "free",
        mujoco.mjtJoint.mjJNT_BALL: "ball",
        mujoco.mjtJoint.mjJNT_SLIDE: "slide",
        mujoco.mjtJoint.mjJNT_HINGE: "hinge",
    }
    bodies = [
        {
            "name": model.body(k).name,
            "parent": int(model.body_parentid[k]),
            "pos": model.body_pos[k].tolist(),
            "quat": model.body_quat[k].tolist(),
            "mass": float(model.body_mass[k]),
            "com": model.body_ipos[k].tolist(),
            "axes": model.body_iquat[k].tolist(),
            "inertia": model.body_inertia[k].tolist(),
        }
        for k in range(model.nbody)
    ]
    joints = [
        {
            "name": model.joint(k).name,
            "type": joint_types[mujoco.mjtJoint(int(model.jnt_type[k]))],
            "body": int(model.jnt_bodyid[k]),
            "pos": model.jnt_pos[k].tolist(),
            "axis": model.jnt_axis[k].tolist(),
            "reference": float(model.qpos0[model.jnt_qposadr[k]]),
            "range": model.jnt_range[k].tolist() if model.jnt_limited[k] else None,
            "armature": float(model.dof_armature[model.jnt_dofadr[k]]),
        }
        for k in range(model.njnt)
    ]
    sites = [
        {
            "name": model.site(k).name,
            "body": int(model.site_bodyid[k]),
            "pos": model.site_pos[k].tolist(),
            "quat": model.site_quat[k].tolist(),
        }
        for k in range(model.nsite)
    ]
    return {"bodies": bodies, "joints": joints, "sites": sites}


def _couplings(mujoco: Any, model: Any) -> Iterator[dict[str, Any]]:
    """Yield the constraints between joints: 0 = terms of joints + polynomial, at the joints' reference positions.

    A constraint of tendons has all their joints with their coefficients; without a second joint or tendon ``second`` is
    empty.
    """
    for k in range(model.neq):
        kind = mujoco.mjtEq(int(model.eq_type[k]))
        objects = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])  # -1: none
        if kind == mujoco.mjtEq.mjEQ_JOINT:
            first, second = ([(joint, 1.0)] for joint in objects)
        elif kind == mujoco.mjtEq.mjEQ_TENDON:
            first, second = (list(tendon_joints(mujoco, model, tendon)) for tendon in objects)
        else:
            continue
        yield {
            "name": model.equality(k).name,
            "active": _is_enforced(mujoco, model, k),
            "first": first,
            "second": [pair for pair in second if pair[0] >= 0],
            "polynomial": model.eq_data[k][:5].tolist(),
        }


def _is_enforced(mujoco: Any, model: Any, k: int) -> bool:
    """Return whether MuJoCo enforces a constraint: it is active, and no flag disables all of them."""
    off = int(mujoco.mjtDisableBit.mjDSBL_EQUALITY) | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    return bool(model.eq_active0[k]) and not int(model.opt.disableflags) & off


def _loops(mujoco: Any, model: Any) -> Iterator[dict[str, Any]]:
    """Yield the active constraints between bodies or sites: kind, name, and the two frames that they unite."""
    kinds = {mujoco.mjtEq.mjEQ_CONNECT: "connect", mujoco.mjtEq.mjEQ_WELD: "weld"}
    for k in range(model.neq):
        kind = kinds.get(mujoco.mjtEq(int(model.eq_type[k])))
        if kind is None or not _is_enforced(mujoco, model, k):
            continue
        ids = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
        if model.eq_objtype[k] == mujoco.mjtObj.mjOBJ_SITE:
            names = [model.site(i).name for i in ids]
            ends = [_end(model.site_bodyid[i], model.site_pos[i], model.site_quat[i]) for i in ids]
        else:
            names = [model.body(i).name for i in ids]
            ends = _ends_of_bodies(kind, ids, model.eq_data[k])
        name = f" '{model.equality(k).name}'" if model.equality(k).name else ""
        yield {"text": f"{kind}{name} ({names[0]}, {names[1]})", "weld": kind == "weld", "ends": ends}


def _ends_of_bodies(kind: str, ids: tuple[int, int], data: Any) -> list[dict[str, Any]]:
    """Return the frames in two bodies that a constraint unites, from MuJoCo's numbers for it.

    A connection stores its point in the first body, then in the second one. A weld stores its point in the second body,
    then in the first one, and the orientation of the second body in the first.
    """
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    first, second = ids
    if kind == "weld":
        return [_end(first, data[3:6], data[6:10]), _end(second, data[:3], upright)]
    return [_end(first, data[:3], upright), _end(second, data[3:6], upright)]


def _end(body: int, position: Any, quaternion: Any) -> dict[str, Any]:
    return {"body": int(body), "pos": position.tolist(), "quat": quaternion.tolist()}


def answer_for(file: Path) -> dict[str, Any]:
    """Return the answer for a file: its model, or why there is none."""
    try:
        return _compiled(file)
    except ImportError as error:
        return {"missing": str(error)}
    except FileError as error:
        return {"refusal": str(error)}
    except UnicodeDecodeError as error:  # of a name; in comments MuJoCo reads any byte
        fault = f"a name is no UTF-8 text (byte 0x{error.object[error.start]:02x})"
        return {"encoding": f"{fault}; save the file, and those that it includes, as UTF-8"}
    except MemoryError:
        return {"error": f"needs more than {_GIBIBYTES} GiB of memory to compile"}
    except Exception as error:
        return {"error": " ".join(str(error).split()) or type(error).__name__}


def main() -> None:
    """Answer the request on standard input."""
    request = json.load(sys.stdin)
    limit_process(SECONDS, _GIBIBYTES)
    with tempfile.TemporaryDirectory(prefix="stiffgen-mjcf.") as scratch:
        os.chdir(scratch)  # MuJoCo logs into the current folder
        answer = answer_for(Path(request["file"]))
        os.chdir(os.sep)
    json.dump(answer, sys.stdout)


if __name__ == "__main__":
    main()
