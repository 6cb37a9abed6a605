# SPDX-License-Identifier: MIT
"""Every sign of the generated code matters: exchange each one and see a value change, or prove that none can."""

from __future__ import annotations

import collections
import ctypes
import itertools
import re

import numpy as np
import pytest
from mpmath import mp

import stiffgen
from campaigns import exact_c
from stiffgen.core.emit.render import render
from stiffgen.core.options import GenerationOptions
from stiffgen.core.symbolic.choices import KINDS, KernelOptions
from stiffgen.core.symbolic.connection import REPRESENTATIONS
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.symbolic.model import casadi_function
from stiffgen.core.symbolic.placement import Placement
from stiffgen.core.verify.kernels.oracles import oracles_of
from stiffgen.core.verify.kernels.references import References
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.core.verify.result import BOUND, as_results, relative_error
from stiffgen.families.springs.springs import spring as spring_of_kind
from support.chains import chain_urdf
from support.complex_step import columns, gradients
from support.controller_library import compile_c
from support.cuda_host import HostCuda
from support.generated_c import merged
from support.spring_digits import axis, parameters, reference, stiffness, turned


@pytest.fixture(scope="module")
def references(chain):
    return References(chain, count=2, seed=11)


SIGN = re.compile(r" [-+] |(?<== )-|(?<=, )-|(?<=\()-")  # between two terms, or before one
FUNCTION = re.compile(r"(?:static |DEVICE )?void (\w+)\(")
FIRST = r"(?<=[\]\w] = )(?![-({&]|.*\{|0\.0;|same\(0\.0\))|(?<= \+= )(?!-)"  # before the first term, of sums, too
SIGN_OR_FIRST = re.compile(f"{SIGN.pattern}|{FIRST}")
LOWER = re.compile(r"task_stiffness\[(?:6|1[23]|18|19|20|2[4-7]|3[0-4])\] =")  # CUDA writes the upper triangle out
SPRING_KERNELS = ("energy", "wrench", "task_stiffness", "torque", "joint_stiffness", "linearization")
SPRING_BOUND = 5e-14
WRITTEN_BY_HAND = ("load", "store", "store_upper", "take_symmetric_parts", "sine_cosine")


def with_switches(source, chosen=lambda function: True, signs=SIGN):
    """Return the source with ``flip[k]``, 1 or -1, at the k-th sign of every chosen body, and the lines they are in."""
    lines, places, body, section = [], [], "", ""
    poison = closed = False

    def switch(match):
        """Return the sign with a factor `flip[k]` in front, unless its sign means no arithmetic or changes nothing."""
        before = match.string[: match.start()]
        if before.count("[") > before.count("]"):
            return match[0]  # of an index
        if "*const" in before or re.match(r"\d+[,}]", match.string[match.end() :]):
            return match[0]  # a pointer; numbers have a decimal point
        if before.lstrip().startswith("sine_cosine("):
            return match[0]  # of a number of vectors
        if match.string.startswith("poison", match.end()):
            return match[0]  # 0 or NaN whatever its sign
        places.append(f"{body}: {section} {match.string.strip()}")
        return f"{match[0]}flip[{len(places) - 1}] * "

    for line in source.splitlines():
        heading = FUNCTION.match(line)
        if heading:
            printed = heading[1] not in WRITTEN_BY_HAND and not heading[1].endswith("_batch")
            body = heading[1] if printed and chosen(heading[1]) else ""
        elif line.startswith("}"):
            body = ""
        elif line.lstrip().startswith("/*"):
            section = line.strip()
        elif body and not line.lstrip().startswith("for"):
            poison = " poison = 0.0 * (" in line or (poison and not closed)
            closed = line.endswith(";")
            if not poison:
                line = signs.sub(switch, line)
        lines.append(line)
    return "\n".join([f"double flip[{len(places)}];", *lines, ""]), places


def compiled_with_switches(texts, folder):
    """Compile the library of a robot's C in which signs have switches: without vectors or optimisation."""
    for name, text in texts.items():
        (folder / name).write_text(text)
    flags = ["-std=c99", "-O0", "-DSTIFFGEN_NO_VECTORS", "-shared", "-fPIC"]
    return ctypes.CDLL(str(compile_c(folder / "robot.so", *flags, folder / "robot.c", "-lm")))


def switches(library, count):
    """``flip`` of a library, every sign as it is printed."""
    flip = (ctypes.c_double * count).in_dll(library, "flip")
    flip[:] = [1.0] * count
    return flip


def expected_values(references):
    """Arguments (stacks) and results of every kernel, from the oracles of ``stiffgen verify``."""
    known, wanted = oracles_of(references.options), {}
    for kernel in chain_kernels(references.chain, references.options):
        for oracle in known[kernel.function][:1]:
            arguments = references.samples.of(kernel.arguments)
            shapes = [(len(arguments[0]), *result.array(references.chain).shape) for result in kernel.results]
            results = map(np.reshape, as_results(oracle.values(references)), shapes)
            wanted[kernel.qualified_name] = arguments, list(results)
    return wanted


def single_call(function):
    def call(arguments, outs):
        for c in range(len(outs[0])):
            function(*(pointer(a[c : c + 1]) for a in arguments), *(pointer(out[c : c + 1]) for out in outs))

    return call


def batch_call(function):
    def call(arguments, outs):
        steps = ((pointer(a), ctypes.c_ssize_t(a[0].size)) for a in arguments)
        function(ctypes.c_size_t(len(outs[0])), *itertools.chain(*steps), *map(pointer, outs))

    return call


def cuda_call(host, name):
    """Return a call that fills the outputs state by state, from the CUDA function compiled for the host."""

    def call(arguments, outs):
        for c in range(len(outs[0])):
            values = as_results(host(name, *(a[c : c + 1] if a.ndim == 2 else a[c] for a in arguments)))
            for out, value in zip(outs, values, strict=True):
                out[c] = value[0]

    return call


def pointer(array):
    return array.ctypes.data_as(ctypes.c_void_p)


@pytest.fixture(scope="module")
def mutated(request, chain, references, tmp_path_factory):
    """Return a chain, its references, and bodies to leave out.

    Some inertias of the iiwa 14 are too small for their signs to matter; those of the other chains, in which nothing is
    aligned, are not: one with a sliding and a mimic joint, and one of six turning joints, whose mass matrix has no
    loops (and the shape of the Jacobian). The bias forces, of which some terms cancel, have a test of their own. Many
    products of the manipulability vanish in a robot with parallel axes or a sliding joint.
    """
    with_zeros = "bias_forces", "manipulability", "body_columns_vjp"
    if request.param == "iiwa14":
        return chain, references, ("mass_matrix", *with_zeros)
    urdf = tmp_path_factory.mktemp("skew") / "skew.urdf"
    urdf.write_text(
        chain_urdf({"skew": "rrpmr", "turning": "rrrrrr"}[request.param]).replace('"0 0 1"', '"0.48 0.6 0.64"')
    )
    skew = stiffgen.load_chain(urdf)
    return skew, References(skew, count=2, seed=11), with_zeros if request.param == "skew" else ("bias_forces",)


AWAITED = (("skew", "C"),)
MARKS = {"C": pytest.mark.slow, "CUDA on the host": pytest.mark.wide}


@pytest.mark.parametrize(
    ("mutated", "vehicle"),
    [
        pytest.param(*case, marks=() if case in AWAITED else MARKS[case[1]])
        for case in itertools.product(("iiwa14", "skew", "turning"), ("C", "CUDA on the host"))
    ],
    indirect=["mutated"],
)
def test_no_sign_in_the_generated_code_can_be_wrong(vehicle, mutated, tmp_path):
    """Exchange one sign of the printed bodies at a time: single calls and batches, or CUDA."""
    chain, references, left_out = mutated
    texts = merged(render(chain, "robot", GenerationOptions(cuda=True)), "robot")
    file = "robot.c" if vehicle == "C" else "robot.cu"
    texts[file], places = with_switches(texts[file], lambda body: not any(name in body for name in left_out))
    batches = {kernel.qualified_name: kernel.batch for kernel in chain_kernels(chain)}
    if vehicle == "C":
        library = compiled_with_switches(texts, tmp_path)
        calls = [(name, single_call(library[f"robot_{name}"])) for name in batches]
        calls += [(name, batch_call(library[f"robot_{name}_batch"])) for name, batch in batches.items() if batch]
    else:
        for name, text in texts.items():
            (tmp_path / name).write_text(text)
        host = HostCuda(tmp_path / "robot.cu", "robot", chain, tmp_path, level="-O0")
        library = host.library
        calls = [(name, cuda_call(host, name)) for name, batch in batches.items() if batch]
    flip = switches(library, len(places))
    wanted = expected_values(references)
    results = {name: [np.empty(each.shape) for each in expected] for name, (_, expected) in wanted.items()}

    def agrees(name, call):
        arguments, expected = wanted[name]
        call(arguments, results[name])
        return all(relative_error(*pair) <= BOUND for pair in zip(results[name], expected, strict=True))

    assert all(agrees(name, call) for name, call in calls)
    missed = []
    for k, place in enumerate(places):
        flip[k] = -1.0
        caught = next((number for number, each in enumerate(calls) if not agrees(*each)), None)
        if caught is None:
            missed += [place] if vehicle == "C" or not LOWER.search(place) else []
        else:  # it is likely to catch the next sign as well
            calls.insert(0, calls.pop(caught))
        flip[k] = 1.0
    assert missed == []
    bodies = {place.split(":")[0] for place in places}
    suffixes = ("", "_lanes") if vehicle == "C" else ("",)
    assert {f"{rep}_columns{suffix}" for rep in REPRESENTATIONS for suffix in suffixes} < bodies
    assert len(places) > 200


@pytest.mark.slow
@pytest.mark.parametrize("types", ["iiwa14", "rrprr", pytest.param("rrrrrr", marks=pytest.mark.wide)])
def test_no_sign_in_the_bias_forces_can_be_wrong(types, chain, tmp_path):
    """Every sign of both bodies, single and batch, joint by joint: those of a wrist are small beside a shoulder's.

    What is not caught has no effect: the angular velocity of the second link is made of the first joint's axis and its
    own, so that gyroscopic moments of some of its inertias cancel. Run with 60 digits, they still do.
    """
    if types != "iiwa14":
        (tmp_path / "skew.urdf").write_text(chain_urdf(types).replace('"0 0 1"', '"0.48 0.6 0.64"'))
        chain = stiffgen.load_chain(tmp_path / "skew.urdf")
    texts = merged(render(chain, "robot"), "robot")
    texts["robot.c"], places = with_switches(texts["robot.c"], lambda body: "bias_forces" in body)
    library = compiled_with_switches(texts, tmp_path)
    flip = switches(library, len(places))
    arguments, (expected,) = expected_values(References(chain, count=4, seed=11))["bias_forces"]
    scale, found = np.abs(expected).max(axis=0), np.empty(expected.shape)
    calls = single_call(library.robot_bias_forces), batch_call(library.robot_bias_forces_batch)

    def error():
        worst = 0.0
        for call in calls:
            call(arguments, [found])
            worst = np.maximum(worst, (np.abs(found - expected) / scale).max())  # NaN stays
        return worst

    assert error() < 1e-13
    missed = []
    for k in range(len(places)):
        flip[k] = -1.0
        if error() <= BOUND:
            missed.append(k)
        flip[k] = 1.0
    assert {place.split(":")[0] for place in places} == {"robot_bias_forces", "bias_forces_lanes"}
    single = [place.startswith("robot_") for place in places]
    assert sum(single) == len(places) - sum(single) > 150  # the same signs in both
    assert len(missed) == 4  # of them, two in each

    lines = exact_c.statements(texts["robot.c"], "robot_bias_forces")

    def exactly(signs):
        """Evaluate the first state with these signs and 60 digits."""
        named = zip(("q", "velocity", "gravity"), arguments, strict=True)
        given = {name: [mp.mpf(x) for x in each[0]] for name, each in named}
        return exact_c.run(lines, {**given, "flip": signs}, "bias_forces", chain.dof)

    right = exactly([1] * len(places))
    assert np.abs(np.array(right, float) - expected[0]).max() < 1e-13 * scale.max()
    for k in range(len(places)) if types == "rrrrrr" else missed:
        if single[k]:
            changed = exactly([-1 if number == k else 1 for number in range(len(places))])
            difference = max(abs(a - b) / mp.mpf(float(scale.max())) for a, b in zip(right, changed, strict=True))
            assert (difference < 1e-55) == (k in missed), places[k]
            assert difference < 1e-55 or difference > 1e-14


def turned_states(library, chain, kind):
    """Yield turns of the tip that take every branch there is: (q, equilibrium, stiffness, exact values by kernel).

    Each component of the quaternion is the largest in turn, with both signs, alone and with all others; near the
    equilibrium, where a series stands for the angle, the tip's origin is at rest, so that nothing hides the turn.
    """
    random = np.random.default_rng(8)
    turns = [axis(random) * angle for angle in (0.01995, -0.0199, 0.0198, 0.0203, 0.05, 0.3, 1.0, 2.0)]
    for unit in np.eye(3):
        turns += [angle * unit for angle in (0.5, 2.5, -2.5)]
        turns += [angle * (unit + 0.3 * axis(random)) for angle in (2.2, -2.2, 2.5, -2.5)]
    for turn in turns:
        q, pose, J, H = random.uniform(-1.5, 1.5, chain.dof), np.empty((4, 4)), np.empty((6, chain.dof)), np.eye(4)
        library.robot_forward_kinematics(pointer(q), pointer(pose))
        library.robot_hybrid_jacobian(pointer(q), pointer(J))
        near = np.linalg.norm(turn) < 0.1
        H[:3, :3] = turned(pose[:3, :3], turn)
        H[:3, 3] = pose[:3, 3] + (0.0 if near else 0.1 * random.normal(size=3))
        K = stiffness(random)
        K[:3] *= 0.1  # nothing of the turn is small beside the translation
        K[:, :3] *= 0.1
        energy, wrench, hessian = (each[None] for each in reference(kind, Placement(), pose, H, K).values())
        torque, tangent = -wrench @ J, np.empty((1, chain.dof, chain.dof))
        library.robot_hybrid_joint_stiffness(*map(pointer, (q, wrench, hessian, tangent)))
        yield q, H, K, {
            "energy": [energy], "wrench": [wrench], "task_stiffness": [hessian],
            "torque": [torque], "joint_stiffness": [tangent], "linearization": [energy, torque, tangent],
        }  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS[1:])
def test_no_sign_in_the_other_springs_can_be_wrong(kind, chain, tmp_path):
    """Flip each sign in the springs beside the default one: a result must differ from its 60 digits."""
    texts = merged(render(chain, "robot", GenerationOptions(springs=(kind,))), "robot")
    group = spring_of_kind(kind).name
    bodies = {f"robot_{group}_{name}": name for name in SPRING_KERNELS}
    texts["robot.c"], places = with_switches(texts["robot.c"], bodies.__contains__)
    library = compiled_with_switches(texts, tmp_path)
    flip = switches(library, len(places))
    states = list(turned_states(library, chain, kind))

    def results(body):
        found = []
        for q, H, K, values in states:
            found.append([np.empty_like(each) for each in values[bodies[body]]])
            given = [q, *(np.ascontiguousarray(each[0]) for each in parameters(kind, H[None], K[None]))]
            library[body](*map(pointer, given), *map(pointer, found[-1]))
        return found

    def agrees(body, found):
        expected = [values[bodies[body]] for *_, values in states]
        pairs = zip(itertools.chain(*found), itertools.chain(*expected), strict=True)
        return all(relative_error(*pair) <= SPRING_BOUND for pair in pairs)

    right = {body: results(body) for body in bodies}
    assert [body for body, found in right.items() if not agrees(body, found)] == []
    missed, even, run = [], [], collections.Counter()
    for k, place in enumerate(places):
        flip[k] = -1.0
        body = place.split(":")[0]
        run[body] += 1
        found = results(body)
        if agrees(body, found):
            same = all(map(np.array_equal, itertools.chain(*found), itertools.chain(*right[body])))
            (even if same else missed).append(place)
        flip[k] = 1.0
    print(f"{kind}: {len(places)} signs, {len(places) - len(missed) - len(even)} caught, {len(even)} without effect")
    assert missed == []
    # The energy alone is even in the quaternion's vector part, so that some signs cannot matter, to the last bit.
    assert {place.split(":")[0] for place in even} <= {f"robot_{group}_energy"}
    assert len(even) <= (0 if kind == "coupled" else 4)
    assert run.keys() == bodies.keys()
    assert min(run.values()) > 20


PRODUCTS = (
    "hybrid_joint_stiffness_vjp", "body_kinematic_stiffness_vjp", "spring_torque_vjp", "gravity_joint_stiffness_vjp",
)  # fmt: skip
"""Those whose signs are tried without waiting: loops over pairs and joints, running sums, statements."""
LARGE = 1e6


def shared_by(source, bodies):
    """Return the internal functions that products share, each with the product of the first body that calls it."""
    functions = dict(re.findall(r"^(?:static )?void (\w+)\([^;{]*\)\n\{\n(.*?)^\}", source, re.MULTILINE | re.DOTALL))
    shared = [name for name in functions if re.fullmatch(r"\w+_columns\w*_vjp(_lanes)?", name)]
    calls = {name: [body for body in bodies if f" {name}(" in functions.get(body, "")] for name in shared}
    assert any(calls.values())
    return {name: bodies[callers[0]] for name, callers in calls.items() if callers}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("types", "floating", "chosen"),
    [
        ("rpr", True, PRODUCTS),
        pytest.param("rrpmr", False, None, marks=pytest.mark.wide),
        pytest.param("rpm", True, None, marks=pytest.mark.wide),
    ],
)
def test_no_sign_in_a_vector_jacobian_product_can_be_wrong(types, floating, chosen, tmp_path):
    """Every sign and every first term of the products, single calls and batches, against complex steps.

    What is not caught has no effect, a million times as large either, apart from rounding: what is zero, since a joint
    stiffness does not feel where the base is; an inertia about the axis that it is turned about, which no derivative
    feels; conditions, which are true or not.
    """
    (tmp_path / "skew.urdf").write_text(chain_urdf(types).replace('"0 0 1"', '"0.48 0.6 0.64"'))
    chain = stiffgen.load_chain(tmp_path / "skew.urdf", floating_base=floating)
    options = KernelOptions(derivatives=True)
    table = {kernel.qualified_name: kernel for kernel in chain_kernels(chain, options)}
    products = {name: kernel for name, kernel in table.items() if name in (chosen or table) and name.endswith("_vjp")}
    bodies = {f"robot_{name}": name for name in products} | {f"{name}_lanes": name for name in products}
    texts = merged(render(chain, "robot", GenerationOptions(**vars(options))), "robot")
    bodies |= shared_by(texts["robot.c"], bodies)
    texts["robot.c"], places = with_switches(texts["robot.c"], bodies.__contains__, SIGN_OR_FIRST)
    library = compiled_with_switches(texts, tmp_path)
    flip = switches(library, len(places))
    pool = argument_samples(chain, 4, 12, options)

    wanted = {}
    for name, kernel in products.items():
        of = table[name.removesuffix("_vjp")]
        stacks = [columns(pool[a], a.array(chain).shape) for a in kernel.arguments]
        given, cotangents = stacks[: len(of.arguments)], stacks[len(of.arguments) :]
        wanted[name] = [each.reshape(4, -1) for each in gradients(casadi_function(chain, of), given, cotangents)]

    def results(body):
        name = bodies[body]
        given = [np.ascontiguousarray(pool[argument]) for argument in products[name].arguments]
        outs = [np.zeros_like(each) for each in wanted[name]]
        lanes = body.endswith("_lanes")
        run = batch_call(library[f"robot_{name}_batch"]) if lanes else single_call(library[f"robot_{name}"])
        run(given, outs)
        return outs

    def agrees(name, found):
        for value, right in zip(found, wanted[name], strict=True):
            size = np.abs(right).max(axis=0)  # of every entry; rounding is that of the result
            bound = np.maximum(1e-10 * size, 1e-13 * np.abs(right).max())
            if not (np.abs(value - right).max(axis=0) <= bound).all():
                return False
        return True

    def without_effect(found, right):
        pairs = ((np.abs(a - b).max(), np.abs(b).max()) for a, b in zip(found, right, strict=True))
        return all(difference <= 1e-14 * LARGE * size for difference, size in pairs)

    right = {body: results(body) for body in sorted({place.split(":")[0] for place in places})}
    assert [body for body, found in right.items() if not agrees(bodies[body], found)] == []
    missed, without, at_rest = [], 0, [0, 0]
    for k, place in enumerate(places):
        body = place.split(":")[0]
        is_at_rest = bodies[body] == "static_torque_derivatives_vjp"
        at_rest[0] += is_at_rest
        flip[k] = -1.0
        found = results(body)
        if agrees(bodies[body], found):
            flip[k] = LARGE
            if without_effect(results(body), right[body]):
                without += not is_at_rest
                at_rest[1] += is_at_rest
            else:
                missed.append(place)
        flip[k] = 1.0
    print(f"{types}: {len(places)} places, {len(missed)} missed, {without} without effect")
    assert missed == []
    assert without <= (0.01 if chosen else 0.06) * (len(places) - at_rest[0])
    assert at_rest[1] <= 0.2 * at_rest[0]  # weights feel neither the base's place nor its turns about gravity
    calling = {f"{name}_vjp" for name, kernel in table.items() if kernel.part_of}  # another's product, no more
    own = {body: name for body, name in bodies.items() if name not in calling}
    assert set(right) == {body for body, name in own.items() if not body.endswith("_lanes") or products[name].batch}
