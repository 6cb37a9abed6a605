# SPDX-License-Identifier: MIT
"""Measures of the joint stiffness at each row of a recording, and summaries of many rows.

The size of a :class:`Summary` does not depend on the number of rows. It has counts, extremes, sums, histograms on fixed
grids, and minimum and maximum over bins of 2^k rows, with the smallest k that gives at most ``BINS`` bins. Summaries of
parts of a recording merge into the summary of the whole, independent of how the recording was divided.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.lab.analyze.recording import Block, Columns, RowProblem
from stiffgen.lab.analyze.task import Task

MEASURES = (
    "singular_value_symmetric",
    "singular_value_antisymmetric",
    "corrected_antisymmetric",
    "eigenvalue_smallest",
    "eigenvalue_largest",
    "closed_form_difference",
    "force",
    "moment",
    "force_x",
    "force_y",
    "force_z",
    "moment_x",
    "moment_y",
    "moment_z",
    "antisymmetric_per_moment",
    "antisymmetric_deviation",
    "eigenvalue_smallest_deviation",
)
"""Columns of :func:`measured`. ``singular_value_...``: largest singular values of the symmetric and the antisymmetric
part of the conventional stiffness; ``corrected_antisymmetric``: largest entry of (K - K^T)/2 of the corrected one;
``eigenvalue_...``: of the corrected one; ``closed_form_difference``: largest entry of the antisymmetric part of the
conventional stiffness less J^T anti(-Gamma F) J; ``force``, ``moment``: lengths; ``antisymmetric_per_moment``: [1/rad],
NaN below SMALL_MOMENT; ``..._deviation``: standard deviations of ``singular_value_antisymmetric`` and
``eigenvalue_smallest`` that follow from the sensor's noise, NaN without a sensor.
"""

SMALL_MOMENT = 1e-3
"""Smallest moment [N m] by which the antisymmetric part is divided."""

INDEFINITE = 1e-12
"""Share of the largest absolute eigenvalue beyond which an eigenvalue counts as negative or positive."""

LIMIT_MARGIN = 0.1
"""Share of a joint's range by which a position may exceed a limit before its row is bad."""

BINS = 2048
"""Most bins of an envelope over the rows."""
PER_DECADE = 100
"""Bins per decade of the histograms."""
DECADES = (-18, 9)
"""Powers of ten between which the histograms lie."""
GRID_PER_DECADE = 40
"""Bins per decade of the grid of moments and antisymmetric parts."""
GRID_DECADES = (-3, 4)
"""Powers of ten between which the grid lies, on both axes."""
NAMED_ROWS = 20
"""Most rows that are named, of each kind of trouble."""
_LARGEST = 1e150  # largest stiffness and wrench; squares must not overflow
_PLACE = {name: column for column, name in enumerate(MEASURES)}
"""Column of each measure."""


def measured(robot: ModuleType, task: Task, q: FloatArray, wrench: FloatArray) -> FloatArray:
    """Compute the MEASURES of rows.

    Args:
        robot: a generated module.
        task: the computation; ``negate`` and the limits have no effect here.
        q: (N, n) joint positions [rad or m].
        wrench: (N, 6) wrench of the environment on the robot, in ``task.representation`` [N, N m].

    Returns:
        (N, len(MEASURES)); rows whose stiffness overflows are NaN.

    """
    count = len(q)
    wrench = wrench.copy()
    if count == 1:  # single calls and batches differ in the last digit: always make a batch
        q, wrench = np.repeat(q, 2, axis=0), np.repeat(wrench, 2, axis=0)
    functions = task.functions_of(robot)
    K = task.task_stiffness
    conventional = functions.joint_stiffness_uncorrected(q, wrench, K)
    corrected = functions.joint_stiffness(q, wrench, K)
    sound = np.abs(wrench).max(axis=1) < _LARGEST
    for stiffness in (conventional, corrected):
        sound &= np.abs(stiffness).max(axis=(1, 2)) < _LARGEST
    conventional[~sound] = corrected[~sound] = wrench[~sound] = 0.0  # finite for eigvalsh; NaN at the end
    symmetric, antisymmetric = _parts(conventional)
    eigenvalues = np.linalg.eigvalsh(corrected)
    closed = _closed_form(functions, q, wrench)
    force, moment = np.linalg.norm(wrench[:, :3], axis=1), np.linalg.norm(wrench[:, 3:], axis=1)
    largest = _largest_singular_value(antisymmetric)
    columns = [  # in the order of MEASURES
        np.abs(np.linalg.eigvalsh(symmetric)[:, [0, -1]]).max(axis=1),
        largest,
        np.abs(_parts(corrected)[1]).max(axis=(1, 2)),
        eigenvalues[:, 0],
        eigenvalues[:, -1],
        np.abs(antisymmetric - closed).max(axis=(1, 2)),
        force,
        moment,
        *wrench.T,
        np.divide(largest, moment, out=np.full(len(q), np.nan), where=moment >= SMALL_MOMENT),
        *task.deviations(robot, q, wrench).T,
    ]
    result = np.stack(columns, axis=1)
    result[~sound] = np.nan
    return result[:count]


def _parts(matrices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the symmetric and the antisymmetric part."""
    transposed = np.swapaxes(matrices, 1, 2)
    return (matrices + transposed) / 2, (matrices - transposed) / 2


def _largest_singular_value(matrices: FloatArray) -> FloatArray:
    """Compute the largest singular value from the eigenvalues of A^T A, as accurate as an SVD and twice as fast."""
    value: FloatArray = np.sqrt(np.maximum(np.linalg.eigvalsh(np.swapaxes(matrices, 1, 2) @ matrices)[:, -1], 0.0))
    return value


def _closed_form(functions: Any, q: FloatArray, wrench: FloatArray) -> FloatArray:
    """Return the antisymmetric part of the conventional stiffness, which the correction removes: J^T anti(-Gamma F) J.

    In the hybrid representation this is J_r^T [m]x J_r / 2, with J_r the rotational half of the Jacobian.
    """
    J = functions.jacobian(q)
    closed: FloatArray = np.swapaxes(J, 1, 2) @ _parts(-functions.connection_correction(wrench))[1] @ J
    return closed


@dataclass
class Envelope:
    """Minimum, maximum, sum and count of measures, and the time spanned, over bins of 2^shift rows."""

    shift: int
    first: int
    least: FloatArray
    most: FloatArray
    total: FloatArray
    count: NDArray[np.int64]
    start: FloatArray
    stop: FloatArray

    @staticmethod
    def of(rows: NDArray[np.int64], values: FloatArray, times: FloatArray) -> Envelope:
        """Make the envelope of ascending rows (N,) with measures (N, M) and times (N,) [s]."""
        shift = 0
        while (rows[-1] >> shift) - (rows[0] >> shift) >= BINS:
            shift += 1
        bins = rows >> shift
        starts = np.flatnonzero(np.diff(bins, prepend=-1))  # first row of each bin that has one
        first, size = int(bins[0]), int(bins[-1] - bins[0]) + 1
        envelope = Envelope._empty(shift, first, size, values.shape[1])
        place = bins[starts] - first
        known = ~np.isnan(values)
        # reduceat: over the rows from each start to the next one
        envelope.least[place] = np.minimum.reduceat(np.where(known, values, np.inf), starts)
        envelope.most[place] = np.maximum.reduceat(np.where(known, values, -np.inf), starts)
        envelope.total[place] = np.add.reduceat(np.where(known, values, 0.0), starts)
        envelope.count[place] = np.add.reduceat(known.astype(np.int64), starts)
        envelope.start[place] = np.minimum.reduceat(times, starts)
        envelope.stop[place] = np.maximum.reduceat(times, starts)
        return envelope

    @staticmethod
    def _empty(shift: int, first: int, size: int, width: int) -> Envelope:
        """Return ``size`` bins without rows, from number ``first`` on, of ``width`` measures."""
        return Envelope(
            shift=shift,
            first=first,
            least=np.full((size, width), np.inf),
            most=np.full((size, width), -np.inf),
            total=np.zeros((size, width)),
            count=np.zeros((size, width), dtype=np.int64),
            start=np.full(size, np.inf),
            stop=np.full(size, -np.inf),
        )

    def _add(self, other: Envelope) -> None:
        """Add the bins of another envelope, which are as wide or narrower: several may fall into one bin."""
        bins = np.arange(len(other.start)) + other.first
        place = (bins >> (self.shift - other.shift)) - self.first
        np.minimum.at(self.least, place, other.least)
        np.maximum.at(self.most, place, other.most)
        np.add.at(self.total, place, other.total)
        np.add.at(self.count, place, other.count)
        np.minimum.at(self.start, place, other.start)
        np.maximum.at(self.stop, place, other.stop)

    def _span(self, shift: int) -> tuple[int, int]:
        """Return the first and the last bin at another width of 2^shift rows, as wide or wider."""
        wider = shift - self.shift
        return self.first >> wider, (self.first + len(self.start) - 1) >> wider

    def merged(self, other: Envelope) -> Envelope:
        """Merge two envelopes, in bins as wide as needed."""
        shift = max(self.shift, other.shift)
        while True:
            (first, last), (other_first, other_last) = self._span(shift), other._span(shift)
            first, last = min(first, other_first), max(last, other_last)
            if last - first < BINS:
                break
            shift += 1
        result = Envelope._empty(shift, first, last - first + 1, self.least.shape[1])
        result._add(self)
        result._add(other)
        return result


@dataclass
class Summary:
    """Summary of some rows of a recording; see :meth:`merged`.

    Attributes:
        rows: number of rows read. good: number of rows analysed.
        bad: skipped rows by category. named: the first of them, (row, sentence).
        count, total, squares, least, most: values per measure over the good rows.
        least_row, most_row: rows of the extremes.
        indefinite: rows whose corrected stiffness has eigenvalues of both signs.
        asymmetric: rows whose corrected stiffness is not symmetric to the last bit.
        histogram: (M, ...) counts on a logarithmic grid of absolute values, PER_DECADE bins per decade.
        grid: counts of (moment, antisymmetric singular value), GRID_PER_DECADE bins per decade.
        q_least, q_most: (n,) range of the joint positions.
        times: (first, last) time of a good row, or None.
        longest_step: longest time from a row to the next [s].
        backwards: rows whose time is before the time of the previous good row. backwards_named: the first of them.

    """

    # More than twelve fields: the summaries of partitions are merged and sent as one.
    rows: int = 0
    good: int = 0
    bad: Counter[str] = field(default_factory=Counter)
    named: list[tuple[int, str]] = field(default_factory=list)
    count: NDArray[np.int64] = field(default_factory=lambda: np.zeros(len(MEASURES), dtype=np.int64))
    total: FloatArray = field(default_factory=lambda: np.zeros(len(MEASURES)))
    squares: FloatArray = field(default_factory=lambda: np.zeros(len(MEASURES)))
    least: FloatArray = field(default_factory=lambda: np.full(len(MEASURES), np.inf))
    most: FloatArray = field(default_factory=lambda: np.full(len(MEASURES), -np.inf))
    least_row: NDArray[np.int64] = field(default_factory=lambda: np.full(len(MEASURES), -1, dtype=np.int64))
    most_row: NDArray[np.int64] = field(default_factory=lambda: np.full(len(MEASURES), -1, dtype=np.int64))
    indefinite: int = 0
    asymmetric: int = 0
    histogram: NDArray[np.int64] | None = None
    grid: NDArray[np.int64] | None = None
    q_least: FloatArray | None = None
    q_most: FloatArray | None = None
    times: tuple[float, float] | None = None
    first_good: int = -1
    longest_step: float = 0.0
    backwards: int = 0
    backwards_named: list[int] = field(default_factory=list)
    envelope: Envelope | None = None

    def merged(self, other: Summary) -> Summary:
        """Merge with the summary of the rows that follow."""
        if not other.good or not self.good:  # measures of one of the two at most; counts of bad rows of both
            measured = self if self.good else other
            result = Summary(**vars(measured))
            result.rows, result.bad = self.rows + other.rows, self.bad + other.bad
            result.named = (self.named + other.named)[:NAMED_ROWS]
            return result
        assert self.envelope and other.envelope
        assert self.histogram is not None and other.histogram is not None
        assert self.grid is not None and other.grid is not None
        assert self.q_least is not None and other.q_least is not None
        assert self.q_most is not None and other.q_most is not None
        times, longest = self.times, max(self.longest_step, other.longest_step)
        backwards, late = self.backwards + other.backwards, self.backwards_named + other.backwards_named
        if self.times and other.times:  # the step between the two, which neither has counted
            step = other.times[0] - self.times[1]
            longest = max(longest, step)
            if step < 0:
                backwards += 1
                late = [*self.backwards_named, other.first_good, *other.backwards_named]
            times = self.times[0], other.times[1]
        return Summary(
            rows=self.rows + other.rows,
            good=self.good + other.good,
            bad=self.bad + other.bad,
            named=(self.named + other.named)[:NAMED_ROWS],
            count=self.count + other.count,
            total=self.total + other.total,
            squares=self.squares + other.squares,
            least=np.minimum(self.least, other.least),
            most=np.maximum(self.most, other.most),
            least_row=np.where(other.least < self.least, other.least_row, self.least_row),
            most_row=np.where(other.most > self.most, other.most_row, self.most_row),
            indefinite=self.indefinite + other.indefinite,
            asymmetric=self.asymmetric + other.asymmetric,
            histogram=self.histogram + other.histogram,
            grid=self.grid + other.grid,
            q_least=np.minimum(self.q_least, other.q_least),
            q_most=np.maximum(self.q_most, other.q_most),
            times=times,
            first_good=self.first_good,
            longest_step=longest,
            backwards=backwards,
            backwards_named=late[:NAMED_ROWS],
            envelope=self.envelope.merged(other.envelope),
        )

    def quantile(self, measure: str, share: float) -> float:
        """Return a quantile of a measure from its histogram: the middle of a bin (2.3 % wide), or the extreme in it.

        0 below the grid. For measures of one sign: the histogram has absolute values.
        """
        assert self.histogram is not None
        column = MEASURES.index(measure)
        counts = self.histogram[column]
        reached = np.cumsum(counts) >= share * counts.sum()
        index = int(np.argmax(reached))  # the first bin, as argmax stops at the first True
        middle = 0.0 if index == 0 else 10 ** (DECADES[0] + (index - 0.5) / PER_DECADE)
        return float(np.clip(middle, self.least[column], self.most[column]))


class Judged(NamedTuple):
    """Rows of a block: which are good, q and wrench as analysed, MEASURES of the good rows, reasons of the others."""

    good: NDArray[np.bool_]
    q: FloatArray
    wrench: FloatArray
    measures: FloatArray
    reasons: dict[int, RowProblem]


def judged(robot: ModuleType, task: Task, columns: Columns, block: Block) -> Judged:
    """Find the rows of a block that can be analysed, and measure them.

    The first reason against a row counts: that of the reader, a number that is not finite, a position far beyond the
    limits, a stiffness that overflows.
    """
    is_timed = columns.time is not None  # the time stands before the positions
    q = columns.positions(block.values)
    recorded = block.values[:, int(is_timed) + len(columns.q) :]
    reasons = {**_beyond_limits(task, columns, q), **_not_finite(columns, block), **block.problems}
    good = np.ones(len(block.values), dtype=bool)
    good[list(reasons)] = False
    wrench = task.wrench_of(robot, q, recorded)
    analysed = measured(robot, task, q[good], wrench[good])
    overflows = np.isnan(analysed[:, 0])
    for index in np.flatnonzero(good)[overflows]:
        reasons[int(index)] = RowProblem("overflow", "the stiffness is beyond what floating point holds")
        good[index] = False
    return Judged(good, q, wrench, analysed[~overflows], reasons)


def _not_finite(columns: Columns, block: Block) -> dict[int, RowProblem]:
    """Return what is wrong with the rows of a block that have a number which is not finite, by index."""
    rows = np.flatnonzero(~np.isfinite(block.values).all(axis=1)).tolist()
    return {index: _not_a_number(columns, block, index) for index in rows}


def _beyond_limits(task: Task, columns: Columns, q: FloatArray) -> dict[int, RowProblem]:
    """Return what is wrong with the rows whose positions (N, n) are far beyond the limits, by index."""
    margin = LIMIT_MARGIN * (task.upper - task.lower)
    with np.errstate(invalid="ignore"):  # a NaN compares as not beyond; its row has another reason
        is_beyond = (q < task.lower - margin) | (q > task.upper + margin)
    found = {}
    for index in np.flatnonzero(is_beyond.any(axis=1)).tolist():
        joint = int(np.argmax(is_beyond[index]))  # the first one
        text = (
            f"{columns.q[joint]} is {q[index, joint]:.6g}, far beyond the joint's limits "
            f"{task.lower[joint]:.6g} ... {task.upper[joint]:.6g}"
        )
        found[index] = RowProblem("beyond joint limits", text)
    return found


def summarise(robot: ModuleType, task: Task, columns: Columns, block: Block) -> Summary:
    """Return the summary of one block: its bad rows are counted and named, the others measured."""
    good, q, _, analysed, reasons = judged(robot, task, columns, block)
    time = None if columns.time is None else block.values[good, 0]
    result = _of_good_rows(block.rows[good], q[good], time, analysed)
    result.rows = len(block.values)
    result.bad = Counter(problem.category for problem in reasons.values())
    result.named = [(int(block.rows[i]), reasons[i].text) for i in sorted(reasons)[:NAMED_ROWS]]
    return result


def _not_a_number(columns: Columns, block: Block, index: int) -> RowProblem:
    """Return what is wrong with the first entry of a row that is not finite."""
    column = int(np.argmax(~np.isfinite(block.values[index])))
    name, value = columns.names[column], block.values[index, column]
    if block.missing is not None and block.missing[index, column]:
        return RowProblem("missing value", f"{name} is missing")
    if math.isnan(value):
        return RowProblem("not a number", f"{name} is not a number (NaN)")
    return RowProblem("infinite", f"{name} is infinite")


def _of_good_rows(rows: NDArray[np.int64], q: FloatArray, time: FloatArray | None, values: FloatArray) -> Summary:
    """Return the summary of rows that follow each other, with MEASURES ``values`` (N, M), some of which may be NaN."""
    if not len(rows):
        return Summary()
    known = ~np.isnan(values)
    filled = np.where(known, values, 0.0)
    low, high = np.where(known, values, np.inf), np.where(known, values, -np.inf)
    measure = {name: values[:, column] for name, column in _PLACE.items()}
    smallest, largest = measure["eigenvalue_smallest"], measure["eigenvalue_largest"]
    tolerance = INDEFINITE * np.maximum(np.abs(smallest), np.abs(largest))
    result = Summary(
        good=len(rows),
        count=known.sum(axis=0),
        total=filled.sum(axis=0),
        squares=(filled**2).sum(axis=0),
        least=low.min(axis=0),
        most=high.max(axis=0),
        least_row=rows[low.argmin(axis=0)],
        most_row=rows[high.argmax(axis=0)],
        indefinite=int(((smallest < -tolerance) & (largest > tolerance)).sum()),
        asymmetric=int((measure["corrected_antisymmetric"] != 0).sum()),
        histogram=_histogram(values),
        grid=_grid(measure["moment"], measure["singular_value_antisymmetric"]),
        q_least=q.min(axis=0),
        q_most=q.max(axis=0),
        first_good=int(rows[0]),
        envelope=Envelope.of(rows, values, np.zeros(len(rows)) if time is None else time),
    )
    if time is not None:
        steps = np.diff(time)
        late = np.flatnonzero(steps < 0)
        result.times = float(time[0]), float(time[-1])
        result.longest_step = max(0.0, float(steps.max(initial=0.0)))
        result.backwards = len(late)
        result.backwards_named = [int(row) for row in rows[late[:NAMED_ROWS] + 1]]
    return result


def _decade_bins(values: FloatArray, decades: tuple[int, int], per_decade: int) -> NDArray[np.int64]:
    """Return bins: 0 below the grid, the last one above it. NaN goes to bin 0; the caller must exclude it."""
    size = (decades[1] - decades[0]) * per_decade
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.floor((np.log10(np.abs(values)) - decades[0]) * per_decade) + 1
    bins: NDArray[np.int64] = np.clip(np.nan_to_num(place, nan=0, neginf=0), 0, size + 1).astype(np.int64)
    return bins


def _histogram(values: FloatArray) -> NDArray[np.int64]:
    """Return the counts (M, bins) of measures (N, M) on the logarithmic grid; NaN counts nowhere."""
    size = (DECADES[1] - DECADES[0]) * PER_DECADE + 2
    bins = _decade_bins(values, DECADES, PER_DECADE)
    known = ~np.isnan(values)
    counts = [np.bincount(bins[known[:, m], m], minlength=size) for m in range(values.shape[1])]
    return np.stack(counts).astype(np.int64)


def _grid(moment: FloatArray, antisymmetric: FloatArray) -> NDArray[np.int64]:
    """Return the counts (bins, bins) of rows by moment [N m] and antisymmetric part, each (N)."""
    size = (GRID_DECADES[1] - GRID_DECADES[0]) * GRID_PER_DECADE + 2
    x, y = (_decade_bins(v, GRID_DECADES, GRID_PER_DECADE) for v in (moment, antisymmetric))
    counts = np.bincount(x * size + y, minlength=size * size)  # of each cell, row by row
    return counts.reshape(size, size).astype(np.int64)


def stiffness_unit(chain: Chain) -> str:
    """Return the unit of joint stiffness: one for arms whose joints all turn, all slide, or are mixed."""
    sliding = [coordinate.type == "prismatic" for coordinate in chain.coordinates]
    if all(sliding):
        return "N/m"
    return "N m/rad, N/rad, N/m" if any(sliding) else "N m/rad"


def units(chain: Chain) -> Mapping[str, str]:
    """Return the unit of each of MEASURES."""
    stiffness = stiffness_unit(chain)
    result = {}
    for name in MEASURES:
        if name.startswith("force"):
            result[name] = "N"
        elif name.startswith("moment"):
            result[name] = "N m"
        else:
            result[name] = "1/rad" if name == "antisymmetric_per_moment" else stiffness
    return result
