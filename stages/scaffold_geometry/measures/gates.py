"""The quality gates of a solid: conditions on its metrics, with one line for each that fails."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import Field, field_validator

from scaffold_pipeline.artifacts import Fact, Gate, ScalarField, VolumeMesh
from scaffold_pipeline.stages.contract import Millimetres, Params, Share

MANIFOLD = Gate("manifold", "The surface is closed, with two triangles at each edge.", "gate_manifold")
POROSITY_ASKED_FOR = Gate("porosity", "The porosity is the requested one.", "gate_porosity")

GATES = (
    MANIFOLD,
    Gate("one_piece", "The solid is one piece without closed pores.", "gate_one_piece"),
    Gate("pores_connected", "The pores are connected.", "gate_pores_connected"),
    Gate("interrupted", "Struts are whole and channels open in the file itself.", "gate_interrupted"),
    POROSITY_ASKED_FOR,
    Gate("certificate", "The iso-value is in the window of the certificate.", "gate_certificate"),
    Gate("min_strut", "The thinnest strut has at least the required thickness.", "min_strut"),
    Gate("min_throat", "The narrowest throat has at least the required width.", "min_throat"),
    Gate("build_volume", "The solid fits into the printer.", "build_volume"),
)
"""The gates of `failed_gates`."""


class GateParams(Params):
    """A switch and a tolerance for each quality gate of a solid."""

    porosity_tolerance: Share = Field(default=0.005, gt=0.0, lt=1.0)
    """Greatest difference of the porosity from the requested one."""

    least_connected_pores: Share = Field(default=0.99, ge=0.0, le=1.0)
    """Least connected share of the pore volume; the clip separates small pores at the surface."""

    most_interrupted: Share = Field(default=0.02, ge=0.0, le=1.0)
    """Greatest share of struts, and of channels, that may be interrupted in the file."""

    min_strut: Millimetres | None = Field(default=None, gt=0.0)
    """Least thickness of every strut, of which none may be broken; no limit by default."""

    min_throat: Millimetres | None = Field(default=None, gt=0.0)
    """Least width of the throat of every channel, of which none may be closed; no limit by default."""

    build_volume: tuple[Millimetres, Millimetres, Millimetres] | None = None
    """Size of the printer's build volume, into which the solid must fit in some axis order; no limit by default."""

    gate_manifold: bool = True
    """Whether an open or non-manifold solid fails."""

    gate_one_piece: bool = True
    """Whether a solid of several pieces, or with closed pores, fails; with a skin closed pores are allowed."""

    gate_pores_connected: bool = True
    """Whether unconnected pores fail, and connected ones of a field with separate networks by design."""

    gate_interrupted: bool = True
    """Whether too many broken struts or closed channels in the file fail."""

    gate_porosity: bool = True
    """Whether a porosity outside the tolerance fails."""

    gate_certificate: bool = True
    """Whether an iso-value outside the certificate's window fails."""

    @field_validator("build_volume")
    @classmethod
    def _has_room(cls, room: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        if room is not None and min(room) <= 0.0:
            raise ValueError(f"must be three lengths above 0 mm, got {room}")
        return room


def gates_not_applied(field: ScalarField, mesh: VolumeMesh | None, params: GateParams) -> Iterator[str]:
    """Yield a line for each gate that is on, but has nothing to judge."""
    if params.gate_certificate and field.certificate is None:
        yield "certificate: the field has none"
    if params.gate_interrupted and mesh is None:
        yield "interrupted: there is no mesh, so no struts and channels to check"


def failed_gates(values: dict[str, Fact], params: GateParams, *, most_closed: int) -> Iterator[str]:
    """Yield a line for each gate that is on and fails: which, by how much, and what to change."""
    if params.gate_manifold and not values["is_manifold"]:
        yield "manifold: the solid has open, non-manifold or touching parts; use other voxels or smoothing"
    pieces, closed = to_number(values["solid_pieces"]), to_number(values["closed_pores"])
    if params.gate_one_piece and (pieces != 1 or closed > most_closed):
        yield (
            f"one_piece: {pieces:g} pieces and {closed:g} closed pores instead of 1 and {most_closed}; lower porosity, "
            "or let intersect_outer fill larger pores (min_closed_pore)"
        )
    yield from _failed_shares(values, params)
    yield from _failed_certificate(values) if params.gate_certificate else ()
    yield from _failed_interruptions(values, params) if params.gate_interrupted else ()
    yield from _failed_sizes(values, params)


def _failed_shares(values: dict[str, Fact], params: GateParams) -> Iterator[str]:
    yield from _failed_connections(values, params.least_connected_pores) if params.gate_pores_connected else ()
    porosity = to_number(values["porosity"])
    asked = values["porosity_requested"]
    if params.gate_porosity and asked is not None and abs(porosity - to_number(asked)) > params.porosity_tolerance:
        yield (
            f"porosity: {porosity:.4f} differs from the {to_number(asked):g} requested by more than "
            f"{params.porosity_tolerance:g}; less smoothing or smaller voxels bring it nearer"
        )


def _failed_connections(values: dict[str, Fact], least: float) -> Iterator[str]:
    networks = to_number(values["pore_networks"])
    connected, largest = to_number(values["pore_networks_fraction"]), to_number(values["pore_largest_fraction"])
    if connected < least:
        parted = f" in {networks:g} networks" if networks > 1 else ""
        yield (
            f"pores_connected: {100 * connected:.2f} % of the pore volume is connected{parted}; at least "
            f"{100 * least:g} % is required; raise porosity or use smaller voxels"
        )
    elif networks > 1 and largest >= least:
        yield (
            f"pores_connected: {100 * largest:.2f} % of the pore volume is connected instead of forming {networks:g} "
            "networks, so the sheet between them has holes; lower porosity or use smaller voxels"
        )


def _failed_certificate(values: dict[str, Fact]) -> Iterator[str]:
    if values.get("channel_max") is None:
        return
    iso, low, high = (to_number(values[name]) for name in ("iso", "channel_max", "strut_min"))
    if iso <= low:
        yield (
            f"certificate: iso {iso:.4f} is {low - iso:.4f} below channel_max: {values['channels_closed']} of "
            f"{values['channels']} channels may be closed; raise porosity, or lower c"
        )
    if iso >= high:
        yield (
            f"certificate: iso {iso:.4f} is {iso - high:.4f} above strut_min: {values['struts_broken']} of "
            f"{values['struts']} struts may be broken; lower porosity, or lower c"
        )


def _failed_interruptions(values: dict[str, Fact], params: GateParams) -> Iterator[str]:
    for name, state in (("struts", "broken"), ("channels", "closed")):
        found, count = values.get(f"{name}_interrupted"), values.get(name)
        if found and count and to_number(found) > params.most_interrupted * to_number(count):
            yield (
                f"interrupted: {found} of {count} {name} are {state} in the file, more than the share of "
                f"{params.most_interrupted:g} allowed; use smaller voxels, or larger cells"
            )


def _failed_sizes(values: dict[str, Fact], params: GateParams) -> Iterator[str]:
    for name, asked, parts, key, remedy in (
        ("min_strut", params.min_strut, "struts broken", "thinnest_strut", "lower porosity"),
        ("min_throat", params.min_throat, "channels closed", "narrowest_throat", "raise porosity"),
    ):
        if asked is not None:
            yield from _failed_size(values, f"{name}: ", (asked, parts, key), remedy)
    size = [to_number(values[f"size_{axis}_mm"]) for axis in "xyz"]
    room = params.build_volume
    if room is not None and any(needed > there for needed, there in zip(sorted(size), sorted(room), strict=True)):
        measures, rooms = (" x ".join(f"{length:g}" for length in lengths) for lengths in (size, room))
        yield f"build_volume: {measures} mm do not fit into {rooms} mm; print it in parts, or scale the input"


def _failed_size(values: dict[str, Fact], name: str, rule: tuple[float, str, str], remedy: str) -> Iterator[str]:
    """Yield a line where a part is interrupted, or less than the `rule` asks: mm, the parts and their key."""
    asked, parts, key = rule
    remedy = f"at least {asked:g} mm is required; {remedy}, or use larger cells or smaller voxels"
    kind, _, state = parts.partition(" ")
    interrupted, found = values.get(f"{kind}_interrupted"), values.get(f"{key}_mm")
    if interrupted:
        yield f"{name}{interrupted} {kind} are {state} in the file, where {remedy}"
    elif found is None:
        yield f"{name}nothing to measure; the config needs a mesh before measure"
    elif to_number(found) < asked:
        yield f"{name}{to_number(found):.3g} mm at ({values[f'{key}_at']}), {remedy}"


def to_number(fact: Fact) -> float:
    """Return a fact that is a number, 0 for what is none."""
    return float(fact) if isinstance(fact, int | float) else 0.0
