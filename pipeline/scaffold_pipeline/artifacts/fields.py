"""Fields: values on a regular grid, and a certificate of open channels and whole struts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from scaffold_pipeline.artifacts.declarations import Metric
from scaffold_pipeline.artifacts.meshes import Artifact, Fact, Floats
from scaffold_pipeline.errors import StageError

if TYPE_CHECKING:
    import pyvista

CERTIFICATE_METRICS = (
    Metric("channel_max", "", "Greatest field value on a channel", "Above it all channels are open.", ""),
    Metric("strut_min", "", "Least field value on a strut", "Below it all struts are whole.", ""),
    Metric("channels", "", "Channels", "Line segments from a cell's centre to the centres of its faces.", ""),
    Metric(
        "channels_closed",
        "",
        "Channels closed",
        "Channels that are closed at this iso-value, by the certificate.",
        "Connectivity",
    ),
    Metric("struts", "", "Struts", "Edges of the mesh.", ""),
    Metric("struts_broken", "", "Struts broken", "Mesh edges with a gap, by the certificate.", "Struts"),
)
"""The metrics of `Certificate.at`, except the next."""

UNDER_RESOLVED = Metric(
    "under_resolved", "", "Struts and channels too thin for the voxels", "Thinner than two voxels.", "Printability"
)


@dataclass(frozen=True, eq=False)
class Certificate(Artifact):
    """The connectivity of a field, known before any voxel is computed (sampled along each strut and channel).

    Above `channel_max` every pore is connected to its neighbours, below `strut_min` every strut is whole.

    Parameters
    ----------
    channel_maxima : array (n,) float64
        Greatest value of the field on each channel.
    strut_minima : array (m,) float64
        Least value on each mesh edge.
    channel_rings, strut_rings : array (n, 3), (m, 3) float64, optional
        The same on rings around each, at distances of `RING_SHARES` times `voxel_size`; None if not sampled.
    voxel_size : float, default 0.0
        Distance from voxel to voxel, mm.

    Examples
    --------
    >>> window = Certificate([-0.9, -0.7], [0.8, 0.6])
    >>> window.channel_max, window.strut_min
    (-0.7, 0.6)
    >>> window.at(0.7)["struts_broken"]
    1
    """

    RING_SHARES: ClassVar[tuple[float, ...]] = (1.0, 0.5, 0.25)
    """Ring radii, voxels. A strut that is void at 1 is thinner than two voxels; the others show which size would do."""

    channel_maxima: Floats
    strut_minima: Floats
    channel_rings: Floats | None = None
    strut_rings: Floats | None = None
    voxel_size: float = 0.0

    def __post_init__(self) -> None:
        for name in ("channel_maxima", "strut_minima"):
            self.own_array(name, np.float64, (None,))
        for name in ("channel_rings", "strut_rings"):
            if getattr(self, name) is not None:
                self.own_array(name, np.float64, (None, len(self.RING_SHARES)))
        super().__post_init__()

    @property
    def channel_max(self) -> float:
        """Greatest field value on any channel: every pore is connected to its neighbours at an iso-value above it."""
        return float(self.channel_maxima.max())

    @property
    def strut_min(self) -> float:
        """Least field value on any strut: every strut is whole at an iso-value below it."""
        return float(self.strut_minima.min())

    def at(self, iso: float) -> dict[str, Fact]:
        """Return the window, and the numbers of closed channels, broken struts and too thin ones at `iso`."""
        return {
            "channel_max": self.channel_max,
            "strut_min": self.strut_min,
            "channels": len(self.channel_maxima),
            "channels_closed": int((self.channel_maxima >= iso).sum()),
            "struts": len(self.strut_minima),
            "struts_broken": int((self.strut_minima <= iso).sum()),
            "under_resolved": None if (counts := self._thin(iso)) is None else counts[0],
        }

    def resolving_voxel_size(self, iso: float) -> float | None:
        """Return the greatest tried voxel size, mm, at which no strut or channel is thinner than two voxels."""
        counts = self._thin(iso) or []
        enough = [share for share, count in zip(self.RING_SHARES, counts, strict=False) if not count]
        return self.voxel_size * enough[0] if enough else None

    def _thin(self, iso: float) -> list[int] | None:
        """Return the number of struts and channels thinner than two voxels, for each of the ring shares."""
        if self.channel_rings is None or self.strut_rings is None:
            return None
        counts: list[int] = ((self.channel_rings >= iso).sum(axis=0) + (self.strut_rings <= iso).sum(axis=0)).tolist()
        return counts


@dataclass(frozen=True, eq=False)
class ScalarField(Artifact):
    """A field on a regular grid: the solid is where it is above the iso-value.

    Parameters
    ----------
    values : array (nx, ny, nz) float32
        Value [i, j, k] is at `origin + spacing * (i, j, k)`; one layer along z is a planar field or a section.
    origin : array (3,) float64
        Position of the first value, mm.
    spacing : float
        Distance from value to value, mm, the same along all axes.
    certificate : Certificate, optional
        The field's certificate of connectivity.
    facts : mapping, optional
        Measured by the stage that makes it.
    points, point_values : array (n, 3) float64, array (n,) float64, optional
        Requested points, mm, and the exact field there.
    pore_networks : int, default 1
        Number of separate pore networks by design: a sheet surface has two.

    Raises
    ------
    StageError
        An array has another shape, a value is not finite, or `spacing` is not positive.

    Examples
    --------
    >>> field = ScalarField(np.zeros((3, 4, 5)), origin=(0.0, 0.0, 0.0), spacing=0.5)
    >>> field.summary()["grid"]
    '3 x 4 x 5'
    >>> field.to_pyvista().bounds
    BoundsTuple(x_min = 0.0,
                x_max = 1.0,
                y_min = 0.0,
                y_max = 1.5,
                z_min = 0.0,
                z_max = 2.0)
    """

    values: NDArray[np.float32]
    origin: Floats
    spacing: float
    certificate: Certificate | None = None
    facts: Mapping[str, Fact] = field(default_factory=dict)
    points: Floats = field(default_factory=lambda: np.empty((0, 3)))
    point_values: Floats = field(default_factory=lambda: np.empty(0))
    pore_networks: int = 1

    def __post_init__(self) -> None:
        self.own_array("values", np.float32, (None, None, None))
        self.own_array("origin", np.float64, (3,))
        self.own_array("points", np.float64, (None, 3))
        self.own_array("point_values", np.float64, (len(self.points),))
        if not 0.0 < self.spacing < np.inf:
            raise StageError(f"ScalarField.spacing: must be a positive length, got {self.spacing}")
        if min(self.values.shape[:2]) < 2 or not self.values.size:  # a square has two along each axis
            raise StageError(
                f"ScalarField.values: needs two samples along x and y, one along z, got {self.values.shape}"
            )
        super().__post_init__()

    def to_pyvista(self) -> pyvista.ImageData:
        """Return a `pyvista.ImageData` in mm, with the values as the point data `field`."""
        from scaffold_pipeline.artifacts.conversions import field_to_pyvista

        return field_to_pyvista(self)

    def summary(self) -> dict[str, Fact]:
        """Return the grid's size, the range of values and the certificate's window."""
        window = self.certificate and {
            "channel_max": self.certificate.channel_max,
            "strut_min": self.certificate.strut_min,
        }
        return {
            "voxels": int(self.values.size),
            "voxel_size": self.spacing,
            "grid": " x ".join(map(str, self.values.shape)),
            "least_value": float(self.values.min()),
            "greatest_value": float(self.values.max()),
            **(window or {}),
            **self.facts,
        }
