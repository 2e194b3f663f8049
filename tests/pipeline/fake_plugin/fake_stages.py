"""Stages of an installed plug-in that need no geometry: what the engine's tests run."""

from __future__ import annotations

import os
import signal
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from scaffold_pipeline.artifacts import Artifact, Curve, Fact, Finding, Floats, Histogram, Metrics
from scaffold_pipeline.errors import PipelineWarning, StageError
from scaffold_pipeline.processes.threads import thread_count
from scaffold_pipeline.stages.contract import Follows, InputFile, Millimetres, Params, Unit, stage


@dataclass(frozen=True, eq=False)
class Points(Artifact):
    """Points in space, `places` (n, 3) mm."""

    places: Floats

    def __post_init__(self) -> None:
        self.own_array("places", np.float64, (None, 3))
        super().__post_init__()

    def summary(self) -> dict[str, Fact]:
        return {"points": len(self.places), "reach": float(np.abs(self.places).max(initial=0.0))}


@dataclass(frozen=True, eq=False)
class Picture(Artifact):
    """A drawing of points, with its notes."""

    points: Points
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Block(Points):
    """Points that fill a cube of `side` mm."""

    side: float = 1.0

    def summary(self) -> dict[str, Fact]:
        return {**super().summary(), "volume_mm3": self.side**3, **{f"size_{axis}": self.side for axis in "xyz"}}


class MakePointsParams(Params):
    """Parameters of `make_points`."""

    count: int = Field(default=4, ge=1)
    """Number of points."""

    step: Millimetres = Field(default=1.0, gt=0.0)
    """Distance from point to point."""


@stage(writes="points", version=1)
def make_points(*, params: MakePointsParams) -> Points:
    """Make points along x."""
    return Points(np.arange(params.count)[:, None] * [params.step, 0.0, 0.0])


class ReadPointsParams(Params):
    """Parameters of `read_points`."""

    path: InputFile
    """One coordinate along x a line."""


@stage(writes="points", version=1)
def read_points(*, params: ReadPointsParams) -> Points:
    """Read points along x from a text file."""
    lines = params.path.read_text(encoding="utf-8").split()
    return Points(np.array([[float(line), 0.0, 0.0] for line in lines]))


class ScatterPointsParams(Params):
    """Parameters of `scatter_points`."""

    amount: Millimetres = Field(default=0.1, ge=0.0, lt=0.5)
    """Greatest distance that a point moves."""


@stage(writes="points", version=1)
def scatter_points(points: Points, *, params: ScatterPointsParams, rng: np.random.Generator) -> Points:
    """Move points at random."""
    return Points(points.places + rng.uniform(-params.amount, params.amount, points.places.shape))


class GrowPointsParams(Params):
    """Parameters of `grow_points`."""

    factor: Annotated[float, Unit("times")] = Field(default=2.0, gt=0.0)
    """What coordinates are multiplied by."""

    limit: Annotated[float, Unit("mm"), Follows("count_points", "limit")] = 100.0
    """Reach from which on a warning is given."""


@stage(writes="points", version=1)
def grow_points(points: Points, *, params: GrowPointsParams) -> Points:
    """Multiply the coordinates of points, with a warning where they reach far."""
    grown = Points(points.places * params.factor)
    if np.abs(grown.places).max() > params.limit:
        warnings.warn(f"the points reach beyond {params.limit:g} mm", PipelineWarning, stacklevel=2)
        np.log(np.zeros(1))  # a warning that is not for the user
    return grown


class DrawPointsParams(Params):
    """Parameters of `draw_points`."""


@stage(writes="picture", version=1)
def draw_points(points: Points, *, params: DrawPointsParams) -> Picture:  # noqa: ARG001 - the contract asks for it
    """Draw points."""
    return Picture(points, notes=("drawn",))


class WritePointsParams(Params):
    """Parameters of `write_points`."""

    names: tuple[str, ...] = ("points.txt",)
    """Files to write."""


@stage(writes="picture", version=1)
def write_points(points: Points, *, params: WritePointsParams, out: Path, config_hash: str | None = None) -> Picture:
    """Write points to text files that name their configuration."""
    for name in params.names:
        (out / name).write_text(f"{config_hash}\n{points.places.tolist()}\n", encoding="utf-8")
    return Picture(points)


class CountPointsParams(Params):
    """Parameters of `count_points`."""

    least: int = 1
    """Fewest points of good quality."""

    limit: Millimetres = 50.0
    """Greatest reach of good quality."""


@stage(writes="metrics", version=1)
def count_points(points: Points, picture: Picture | None = None, *, params: CountPointsParams) -> Metrics:
    """Count points, and whether they were drawn."""
    values = {"points": len(points.places), "drawn": picture is not None}
    gates = [f"points: must be {params.least} at least, got {len(points.places)}"]
    return Metrics(values, tuple(gates) if len(points.places) < params.least else ())


class SpanPointsParams(Params):
    """Parameters of `span_points`."""

    most: Millimetres = 100.0
    """Greatest length of good quality."""

    key: str = "length"
    """The key that the length is told under."""


@stage(writes="span", version=1)
def span_points(points: Points, *, params: SpanPointsParams) -> Metrics:
    """Measure how far points lie apart along x, with all that a measure may tell."""
    x = np.sort(points.places[:, 0])
    gate = f"length: must be at most {params.most:g} mm, got {np.ptp(x):g}"
    return Metrics(
        {params.key: float(np.ptp(x))},
        (gate,) if np.ptp(x) > params.most else (),
        histograms=(Histogram("gaps", "Gaps between points", "mm", [0.0, 1.0, 2.0], [0.5, 0.5]),),  # type: ignore[arg-type]
        curves=(Curve("order", "Points in their order", "point", "x, mm", np.arange(len(x)), x),),
        findings=(Finding("far", "the farthest point", points.places[-1:]),),
        strut_thickness=np.full(len(x), 0.5),
    )


class FailParams(Params):
    """Parameters of `fail`."""

    how: Literal["stage_error", "error", "memory", "interrupt", "nothing", "other_type", "nan", "int64", "folder"]
    """What goes wrong."""


@stage(writes="failure", version=1)
def fail(points: Points | None = None, *, params: FailParams, out: Path) -> Points:
    """Fail in the way that is asked for."""
    if params.how == "stage_error":
        raise StageError("the points are too few, 4; give more")
    if params.how == "error":
        raise ValueError("two\nlines")
    if params.how == "memory":
        raise MemoryError
    if params.how == "interrupt":
        raise KeyboardInterrupt
    if params.how == "folder":
        (out / "folder").mkdir()
    if params.how in {"nan", "int64"}:
        return Odd(np.zeros((1, 3)), float("nan") if params.how == "nan" else np.int64(3))  # type: ignore[arg-type]
    return Metrics({}) if params.how == "other_type" else points or Points(np.zeros((1, 3)))  # type: ignore[return-value]


@dataclass(frozen=True, eq=False)
class Odd(Points):
    """Points with a fact that JSON may not hold."""

    fact: Fact = None


class WaitParams(Params):
    """Parameters of `wait`."""

    seconds: Annotated[float, Unit("s")] = 0.0
    """How long to wait."""

    sign: str
    """A file that is made when the waiting begins."""


@stage(writes="points", version=1)
def wait(points: Points, *, params: WaitParams, out: Path) -> Points:
    """Wait, and say so with a file."""
    (out / "half_written.txt").write_text("half", encoding="utf-8")
    Path(params.sign).touch()
    time.sleep(params.seconds)
    (out / "half_written.txt").unlink()
    return points


class CastPointsParams(Params):
    """Parameters of `cast_points`."""

    log: str
    """A file that gets a line at each call."""

    seconds: Annotated[float, Unit("s")] = 0.0
    """How long it takes."""

    voxel_size: Millimetres | None = None
    """Nothing but something to tell of."""


@stage(writes="points", version=1, repeatable=False)
def cast_points(*, params: CastPointsParams) -> Points:
    """Make points that are others at each call, as some libraries do."""
    with Path(params.log).open("a", encoding="utf-8") as stream:
        stream.write("called\n")
    time.sleep(params.seconds)
    return Points(np.frombuffer(os.urandom(12), np.uint8).reshape(-1, 3))


class MakeBlockParams(Params):
    """Parameters of `make_block`."""

    side: Millimetres = 1.0
    """Edge of the cube."""

    log: str
    """A file that gets a line at each call."""


@stage(writes="block", version=1)
def make_block(*, params: MakeBlockParams) -> Block:
    """Make points that fill a cube."""
    with Path(params.log).open("a", encoding="utf-8") as stream:
        stream.write("called\n")
    return Block(np.zeros((1, 3)), params.side)


class DieParams(Params):
    """Parameters of `die`."""

    log: str
    """A file that gets a line at each death."""

    times: int = 1
    """How often the process is ended."""


@stage(writes="points", version=1)
def die(points: Points, *, params: DieParams) -> Points:
    """End the whole process some times, as a system short of memory does."""
    with Path(params.log).open("a+", encoding="utf-8") as stream:
        stream.seek(0)
        if len(stream.readlines()) < params.times:
            stream.write("died\n")
            stream.flush()
            os.kill(os.getpid(), signal.SIGKILL)
    return points


class SolvePointsParams(Params):
    """Parameters of `solve_points`."""


@stage(writes="points", version=1)
def solve_points(points: Points, *, params: SolvePointsParams, rng: np.random.Generator) -> Points:  # noqa: ARG001
    """Make points of a dense system's solution, whose last digits depend on the number of BLAS threads."""
    return Points(np.linalg.solve(rng.normal(size=(400, 400)), np.ones((400, 3))))


class SwayPointsParams(Params):
    """Parameters of `sway_points`."""


@stage(writes="points", version=1)
def sway_points(points: Points, *, params: SwayPointsParams) -> Points:  # noqa: ARG001
    """Move points by what the environment says, as a stage must not."""
    return Points(points.places + float(os.environ.get("SWAY", "0")))


class TellThreadsParams(Params):
    """Parameters of `tell_threads`."""


@stage(writes="points", version=1)
def tell_threads(points: Points, *, params: TellThreadsParams) -> Points:  # noqa: ARG001
    """Make as many points as there are threads for compiled code, as a stage must not."""
    return Points(np.zeros((thread_count(), 3)))
