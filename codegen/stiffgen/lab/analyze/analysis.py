# SPDX-License-Identifier: MIT
"""Stiffness analysis of a recording: ``stiffgen analyze LOG --robot DIR``.

The recording is read as a stream (:mod:`stiffgen.lab.analyze.recording`). :func:`summarise_partition` summarises each
partition, in threads or on Dask workers; the summaries are merged in the order of the file. Both ways give the same
result, to the last bit.
"""

from __future__ import annotations

import json
import math
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import stiffgen.lab.analyze.measures as ms
from stiffgen.cli.folders import folder_of
from stiffgen.core.described import speaking_python
from stiffgen.core.errors import (
    EmptyRecordingError,
    OutputError,
    RecordingError,
    StiffgenError,
    listed,
    printable,
    shell_word,
)
from stiffgen.core.folder import swapped_in
from stiffgen.core.opened import open_robot
from stiffgen.core.options import GenerationOptions
from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.files import exists
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.connection import REPRESENTATIONS, Representation
from stiffgen.core.symbolic.measured import symmetric
from stiffgen.lab.analyze.export import NAME as EXPORT_NAME
from stiffgen.lab.analyze.export import export
from stiffgen.lab.analyze.measures import MEASURES, Summary, units
from stiffgen.lab.analyze.options import EXPORTS, AnalysisOptions, ShowProgress, taking
from stiffgen.lab.analyze.recording import (
    Columns,
    Partition,
    Recording,
    RecordingRequest,
    chosen_names,
    extra,
    open_recording,
    read_blocks,
)
from stiffgen.lab.analyze.report import bad_rows, tool_words, write_report
from stiffgen.lab.analyze.task import SensorTask, Task
from stiffgen.rooms import optional

GENERATOR = "stiffgen analyze"
SUMMARY = "summary.json"
_MOST_THREADS = 8
_AHEAD = 2  # partitions per worker that are queued


@dataclass(frozen=True)
class Analysis:
    """Result of :func:`analyze`.

    Attributes:
        folder: the folder that was written.
        summary: the contents of ``summary.json``.
        result: the merged summary of all rows, with histograms and envelopes.
        recording: the recording.

    """

    folder: Path
    summary: dict[str, Any]
    result: Summary
    recording: Recording


@taking(AnalysisOptions)
def analyze(options: AnalysisOptions) -> Analysis:
    """Analyse the joint stiffness along a recording, corrected and conventional, and write a report.

    Memory does not grow with the recording. Bad rows are skipped and counted; the first ones are named.

    {arguments}

    Returns:
        The findings and the folder with the report.

    Raises:
        EmptyRecordingError: no row could be analysed; nothing is written.
        RecordingError: the recording, its columns or an option cannot be used.
        OutputError: the robot's folder is not from stiffgen or not built, or the output folder cannot be written.
        MissingExtraError: a package is not installed.

    """
    with speaking_python(AnalysisOptions, GenerationOptions):
        return run_analysis(options)


def run_analysis(options: AnalysisOptions) -> Analysis:
    """Do what :func:`analyze` does; refusals name options of the command line."""
    log, progress = Path(options.log), options.progress
    target = Path("analysis") / log.stem if options.output is None else Path(options.output)
    _refuse_foreign(target)
    options = replace(options, robot=folder_of(options.robot, None, lambda step: progress(step, 0.0)))
    robot = Path(options.robot)
    chain = _chain(robot)
    _robot_module(robot.absolute())
    tip = _tip(chain, options.tip)
    task = Task(
        _one_of(options.representation),
        checked_stiffness(options.task_stiffness),
        options.negate_wrench,
        np.array([c.lower for c in chain.coordinates]),
        np.array([c.upper for c in chain.coordinates]),
        tip,
        None if options.calibration is None else _calibrated(options, options.calibration, chain, tip),
    )
    _check(options)
    with swapped_in(target) as staging:  # nothing is written if the analysis fails
        recording = open_recording(log, request_of(options, chain), progress=lambda step: progress(step, 0.0))
        summarised = partial(
            summarise_partition,
            robot=robot.absolute(),
            task=task,
            columns=recording.columns,
            block_rows=options.block_rows,
        )
        result = _reduced(summarised, recording.partitions, options.dask, progress)
        if not result.good:
            raise EmptyRecordingError(_nothing_left(recording, result))
        summary = _summary(robot, recording, chain, task, result)
        (staging / SUMMARY).write_text(json.dumps(summary, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        if options.export is not None:
            _exported(staging, options, task, recording, result)
        if options.figures:
            progress("drawing", 1.0)
            write_report(staging, recording, chain, result, summary)
    return Analysis(target, summary, result, recording)


def _check(options: AnalysisOptions) -> None:
    """Refuse options that do not depend on the robot and cannot be used."""
    if not (math.isfinite(options.tolerance) and options.tolerance >= 0):
        raise RecordingError("--tolerance: must be a time in seconds, not negative")
    if options.block_rows < 1:
        raise RecordingError("block_rows: must be at least 1")
    if options.figures:
        extra("matplotlib", "drawing figures (leave them out with --no-figures)")
    if options.export is not None and options.export not in EXPORTS:
        raise RecordingError(f"--export {shell_word(options.export)}: choose one of {listed(EXPORTS)}")


def request_of(options: AnalysisOptions, chain: Chain) -> RecordingRequest:
    """Return the columns and topics to read."""
    request = RecordingRequest(
        joints=chain.coordinate_names,
        q=chosen_names(options.q),
        wrench=chosen_names(options.wrench),
        time=options.time_column,
        topics=tuple(options.topics),
        tolerance=options.tolerance,
    )
    sliding = [joint.name for joint in chain.joints if joint.prismatic] if request.degrees else ()
    if sliding:
        raise RecordingError(f"--q: {listed(sliding)} slide and have no degrees; record them in m, the others in rad")
    return request


def _exported(folder: Path, options: AnalysisOptions, task: Task, recording: Recording, result: Summary) -> None:
    """Write the corrected stiffness of each good row: the recording is read again, and progress counts its rows."""
    assert options.export is not None
    done = 0.0

    def advance(rows: float) -> None:
        nonlocal done
        done += rows
        options.progress("exporting", done / result.good)

    module = _robot_module(Path(options.robot).absolute())
    export(folder, options.export, module, task, recording, result.good, options.block_rows, advance)


def checked_stiffness(value: ArrayLike) -> FloatArray:
    """Return a task stiffness as a symmetric (6, 6) matrix.

    Raises:
        RecordingError: it is not of that shape, not finite, or not symmetric.

    """
    try:
        K = np.array(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise RecordingError("--task-stiffness: is not six numbers or a 6x6 matrix of numbers") from error
    if K.shape == (6,):
        K = np.diag(K)
    if K.shape != (6, 6):
        raise RecordingError(f"--task-stiffness: six numbers or a 6x6 matrix, not an array of shape {K.shape}")
    if not np.isfinite(K).all():
        raise RecordingError("--task-stiffness: has an entry that is not a finite number")
    try:
        return symmetric("--task-stiffness", K)
    except StiffgenError as error:
        raise RecordingError(str(error)) from error


def read_stiffness(path: str | Path) -> FloatArray:
    """Return a task stiffness from a CSV file of six lines of six numbers, separated by commas.

    Raises:
        RecordingError: it cannot be read, or see :func:`checked_stiffness`.

    """
    try:
        return checked_stiffness(np.loadtxt(path, delimiter=",", ndmin=2))
    except (OSError, ValueError) as error:
        raise RecordingError(f"--task-stiffness {path}: is no CSV file of a 6x6 matrix ({error})") from error


def _one_of(representation: str) -> Representation:
    for known in REPRESENTATIONS:
        if representation == known:
            return known
    raise RecordingError(f"--representation {shell_word(representation)}: choose one of {listed(REPRESENTATIONS)}")


def _chain(robot: Path) -> Chain:
    """Return the chain of a robot's folder; refuse one in single precision, or with the tool given at run time."""
    opened = open_robot(robot)
    opened.require_doubles("'stiffgen analyze'")
    chain = opened.chain
    if chain.runtime_tool:
        raise RecordingError(
            f"{robot}: its functions take the tool's pose at run time, which a recording does not have; "
            "generate the robot with the tool fixed (--tool xyz, --tool rpy)"
        )
    return chain


def _tip(chain: Chain, chosen: str | None) -> str:
    by_link = {tip.link: tip.name for tip in chain.tips}
    if chosen is None:
        if len(chain.tips) == 1:
            return chain.tips[0].name
        raise RecordingError(f"the robot has several tips; choose with --tip: {listed(list(by_link))}")
    if chosen not in by_link:
        raise RecordingError(f"--tip {shell_word(chosen)}: is no tip of the robot; it has {listed(list(by_link))}")
    return by_link[chosen]


def _calibrated(options: AnalysisOptions, file: str | Path, chain: Chain, tip: str) -> SensorTask:
    """Return the sensor of a calibration's file.

    Raises:
        RecordingError: the file is not of the tip's sensor, or an option contradicts.

    """
    room = optional("lab.calibrate.calibration")
    if room is None:
        raise RecordingError("--calibration is read by the package's folder calibrate/, which is not there")
    if options.representation != "hybrid" or options.negate_wrench:
        raise RecordingError(
            "--calibration gives hybrid wrenches of the environment; leave out --negate-wrench and --representation"
        )
    sensor = chain.sensor
    if sensor is None or chain.tips[sensor.tip].name != tip:
        raise RecordingError(
            f"--calibration {shell_word(str(file))}: the robot has no sensor at this tip; generate it with "
            "--sensor LINK"
        )
    found = room.read_calibration(file)
    if found.sensor != sensor.text:
        raise RecordingError(f"{file}: is the calibration of another sensor ({found.sensor}), not of {sensor.text}")
    return SensorTask(np.array(found.bias), np.array(found.payload), np.array(found.noise))


def _refuse_foreign(target: Path) -> None:
    """Raise OutputError unless ``target`` is free or holds an analysis."""
    if not exists(target) and not target.is_symlink():
        return
    try:
        content = json.loads((target / SUMMARY).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        content = None
    if not isinstance(content, dict) or content.get("generator") != GENERATOR or target.is_symlink():
        raise OutputError(
            f"{target}: exists and is not an analysis by stiffgen; move it away or choose another --output"
        )
    ours = {SUMMARY, "report.html", *(f"{EXPORT_NAME}.{kind}" for kind in EXPORTS)}
    foreign = sorted(e.name for e in target.iterdir() if e.name not in ours and e.suffix != ".svg")
    if foreign:
        raise OutputError(
            f"{target}: holds files that stiffgen did not write ({listed(foreign)}); move them away first"
        )


@lru_cache(maxsize=4)
def _robot_module(folder: Path) -> Any:
    return open_robot(folder).module


def summarise_partition(
    partition: Partition,
    *,
    robot: Path,
    task: Task,
    columns: Columns,
    block_rows: int,
    advance: Callable[[float], None] = lambda work: None,
) -> Summary:
    """Read a partition block by block and merge the summaries. Runs in threads and on Dask workers."""
    module = _robot_module(robot)
    summary = Summary()
    for block in read_blocks(partition, block_rows):
        summary = summary.merged(ms.summarise(module, task, columns, block))
        advance(block.work)
    return summary


def _reduced(
    summarised: Callable[..., Summary], partitions: Sequence[Partition], dask: str | None, progress: ShowProgress
) -> Summary:
    """Summarise the partitions, in threads or by Dask, and merge their summaries in order."""
    whole = sum(partition.work for partition in partitions) or 1.0
    result, done, lock = Summary(), 0.0, Lock()

    def advance(work: float) -> None:
        nonlocal done
        with lock:
            done += work
            progress("analysing", min(done / whole, 1.0))

    progress("analysing", 0.0)
    if dask is None:
        threads = min(os.cpu_count() or 1, _MOST_THREADS, max(1, len(partitions)))
        with ThreadPoolExecutor(threads) as pool:
            try:
                submit = partial(pool.submit, partial(summarised, advance=advance))
                for each in _in_order(submit, partitions, _AHEAD * threads):
                    result = result.merged(each)
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
        return result
    with _dask_client(dask, progress) as client:
        workers = max(1, sum(client.ncores().values()))
        submit = partial(client.submit, summarised, pure=False)
        try:
            # workers do not call advance, which stays here: progress counts whole partitions
            for part, each in zip(partitions, _in_order(submit, partitions, _AHEAD * workers), strict=True):
                result = result.merged(each)
                advance(part.work)
        except StiffgenError:
            raise
        except Exception as error:
            raise RecordingError(
                f"--dask {shell_word(dask)}: a worker failed ({type(error).__name__}: {error}); workers need this "
                "version of stiffgen with its extra 'analyze', and the recording and the robot's folder under "
                "the same paths"
            ) from error
    return result


def _in_order(submit: Callable[[Partition], Any], partitions: Iterable[Partition], ahead: int) -> Iterator[Summary]:
    """Yield results in the order of the partitions; at most ``ahead`` are running or waiting."""
    waiting: deque[Any] = deque()
    for partition in partitions:
        waiting.append(submit(partition))
        if len(waiting) > ahead:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


@contextmanager
def _dask_client(address: str, progress: ShowProgress) -> Iterator[Any]:
    """Connect to the scheduler at an address, or start processes for "local"; they end with the block."""
    distributed = extra("distributed", "--dask")
    progress("connecting to Dask" if address != "local" else "starting Dask workers", 0.0)
    if address == "local":
        cores = os.cpu_count() or 1
        with (
            distributed.LocalCluster(n_workers=cores, threads_per_worker=1, dashboard_address=None) as cluster,
            distributed.Client(cluster) as client,
        ):
            yield client
        return
    try:
        client = distributed.Client(address, timeout="10s")
    except (OSError, ValueError, TimeoutError) as error:
        raise RecordingError(
            f"--dask {shell_word(address)}: no scheduler answers there ({error}); start 'dask scheduler'"
        ) from error
    with client:
        if not client.ncores():
            raise RecordingError(
                f"--dask {shell_word(address)}: the scheduler has no workers; start 'dask worker {address}'"
            )
        yield client


def _nothing_left(recording: Recording, result: Summary) -> str:
    if not result.rows:
        return f"{recording.path}: has no rows"
    lines = [f"{recording.path}: none of its {result.rows} rows can be analysed:", *bad_rows(recording, result)]
    return "\n  ".join(lines)


def _measures(recording: Recording, chain: Chain, result: Summary) -> dict[str, Any]:
    """Return the statistics of each measure."""
    unit = units(chain)
    measures = {}
    for index, name in enumerate(MEASURES):
        count = int(result.count[index])
        if not count:
            measures[name] = {"unit": unit[name], "count": 0}
            continue
        measures[name] = {
            "unit": unit[name],
            "count": count,
            "least": float(result.least[index]),
            "least_at": recording.row_name(int(result.least_row[index])),
            "most": float(result.most[index]),
            "most_at": recording.row_name(int(result.most_row[index])),
            "mean": float(result.total[index] / count),
            "rms": math.sqrt(float(result.squares[index]) / count),
        }
        if result.least[index] >= 0:  # quantiles are of absolute values
            measures[name] |= {
                "median": result.quantile(name, 0.5),
                "quantile_95": result.quantile(name, 0.95),
                "quantile_99": result.quantile(name, 0.99),
            }
    return measures


def _smallest_torque_limit(chain: Chain) -> dict[str, Any] | None:
    """Return the turning joint with the smallest torque limit [N m], or None if no joint has one."""
    limited = [each for each in chain.coordinates if each.type != "prismatic" and math.isfinite(each.effort)]
    if not limited:
        return None
    weakest = min(limited, key=lambda each: each.effort)
    return {"joint": weakest.name, "limit": weakest.effort}


def _summary(robot: Path, recording: Recording, chain: Chain, task: Task, result: Summary) -> dict[str, Any]:
    """Return the contents of summary.json; docs/analyze.md lists them."""
    assert result.q_least is not None and result.q_most is not None
    times = result.times
    return {
        "generator": GENERATOR,
        "recording": printable(recording.path.name, 255),
        "robot": chain.robot,
        "folder": printable(robot.name, 255),
        "tool": tool_words(chain),
        "base": chain.base,
        "tip": next(tip.link for tip in chain.tips if tip.name == task.tip),
        "representation": task.representation,
        "wrench_negated": task.negate,
        "task_stiffness": task.task_stiffness.tolist(),
        "columns": {
            "time": recording.columns.time,
            "q": list(recording.columns.q),
            "wrench": list(recording.columns.wrench),
        },
        "notes": list(recording.notes),
        "rows": result.rows,
        "rows_analysed": result.good,
        "rows_bad": dict(sorted(result.bad.items())),
        "rows_bad_first": [{"row": recording.row_name(row), "reason": text} for row, text in result.named],
        "time": None
        if times is None
        else {
            "first": times[0],
            "last": times[1],
            "longest_step": result.longest_step,
            "backwards": result.backwards,
            "backwards_first": [recording.row_name(row) for row in result.backwards_named],
        },
        "rows_indefinite": result.indefinite,
        "share_indefinite": result.indefinite / result.good,
        "rows_corrected_not_symmetric": result.asymmetric,
        "smallest_torque_limit": _smallest_torque_limit(chain),
        "joint_positions": [
            {"joint": coordinate.name, "least": float(low), "most": float(high)}
            for coordinate, low, high in zip(chain.coordinates, result.q_least, result.q_most, strict=True)
        ],
        "measures": _measures(recording, chain, result),
    }
