"""The schema of worlds written in YAML, and what each part of it stands for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from pydantic import BeforeValidator, Field, ValidationInfo, field_validator, model_validator

from beamseg_batch.geometry import FloatArray, RigidTransform, matrix_from_rpy
from beamseg_batch.schema import Finite, Node, Positive, Vector3
from beamseg_batch.world import generators
from beamseg_batch.world.placement import matrix_from_axis_angle, roll_of
from beamseg_batch.world.scene import Member, Rectangle, Section

__all__ = [
    "MIN_LENGTH",
    "BoxConfig",
    "MeshConfig",
    "PlaneConfig",
    "SphereConfig",
    "StructureConfig",
    "WorldConfig",
]

MIN_LENGTH = 1e-3
"""Length of the shortest member, metres; a shorter one is taken for a slip of the pen."""
DEFAULT_RADIUS = 0.05
"""Radius of a round member that names none, metres: that of the report's tests."""

Size2: TypeAlias = tuple[Positive, Positive]
Size3: TypeAlias = tuple[Positive, Positive, Positive]


class PoseConfig(Node):
    """Where something stands."""

    translation: Vector3 = (0.0, 0.0, 0.0)
    """Its origin in the world, metres."""
    rotation_rpy_deg: Vector3 | None = None
    """Roll, pitch and yaw about the world's fixed axes, degrees."""
    rotation_axis_angle: tuple[Finite, Finite, Finite, Finite] | None = None
    """Axis x, y, z and angle in radians, as Webots writes a rotation."""

    @field_validator("rotation_axis_angle")
    @classmethod
    def _has_an_axis(cls, value: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if value is not None and not np.linalg.norm(value[:3]) > 0.0:
            raise ValueError("the axis must not be 0, 0, 0")
        return value

    @model_validator(mode="after")
    def _turned_once(self) -> PoseConfig:
        if self.rotation_rpy_deg is not None and self.rotation_axis_angle is not None:
            raise ValueError("give rotation_rpy_deg or rotation_axis_angle, not both")
        return self

    def transform(self) -> RigidTransform:
        """Return ``T_world_local``."""
        return RigidTransform(self._rotation(), np.array(self.translation))

    def _rotation(self) -> FloatArray:
        if self.rotation_axis_angle is not None:
            *axis, angle = self.rotation_axis_angle
            return matrix_from_axis_angle(np.array(axis), angle)
        return matrix_from_rpy(*np.radians(self.rotation_rpy_deg or (0.0, 0.0, 0.0)))


class SectionConfig(Node):
    """Cross-section of a member."""

    shape: Literal["round", "square", "i", "h", "l", "c"] = "round"
    """Round bar or tube, square or oblong tube, I, H (the same), angle, channel."""
    radius: Positive | None = None
    """Of a round one, metres; 0.05 without."""
    width: Positive | None = None
    """Of any other, along its u: horizontal without roll, metres."""
    height: Positive | None = None
    """Likewise along its v, metres; the width without."""
    thickness: Positive | None = None
    """Of web and flange, metres; a tenth of the smaller of width and height without."""
    web: Positive | None = None
    """Of the parts along v, metres; the thickness without."""
    flange: Positive | None = None
    """Of the parts along u, metres; the thickness without."""

    @field_validator("radius")
    @classmethod
    def _of_a_round(cls, value: float | None, info: ValidationInfo) -> float | None:
        shape = info.data.get("shape", "round")
        if value is not None and shape != "round":
            raise ValueError(f"shape {shape!r} has width and height, no radius")
        return value

    @field_validator("width", "height", "thickness", "web", "flange")
    @classmethod
    def _of_another(cls, value: float | None, info: ValidationInfo) -> float | None:
        if value is not None and info.data.get("shape") == "round":
            raise ValueError("shape 'round' has a radius alone; name the shape")
        return value

    @field_validator("thickness", "web", "flange")
    @classmethod
    def _fits(cls, value: float | None, info: ValidationInfo) -> float | None:
        width, shape = info.data.get("width"), info.data.get("shape")
        if value is None or width is None:
            return value
        height = info.data.get("height") or width
        web = width / 2.0 if shape == "square" else width
        flange = height if shape == "l" else height / 2.0
        limit = {"web": web, "flange": flange}.get(str(info.field_name), min(web, flange))
        if value >= limit:
            raise ValueError(
                f"must be below {limit:g} in a section of {width:g} by {height:g}, not {value:g}"
            )
        return value

    @model_validator(mode="after")
    def _has_a_size(self) -> SectionConfig:
        if self.shape != "round" and self.width is None:
            raise ValueError(f"shape {self.shape!r} needs a width")
        return self

    def section(self) -> Section:
        """Return the section with its defaults filled in."""
        if self.width is None or self.shape == "round":
            diameter = 2.0 * (self.radius or DEFAULT_RADIUS)
            return Section("round", diameter, diameter)
        height = self.height or self.width
        thickness = self.thickness or min(self.width, height) / 10.0
        shape = "i" if self.shape == "h" else self.shape
        return Section(shape, self.width, height, self.web or thickness, self.flange or thickness)


class MemberConfig(SectionConfig):
    """A member, by its ends or by its pose and length."""

    name: str | None = None
    """Its name; its number in the list without."""
    ends: tuple[Vector3, Vector3] | None = None
    """Both ends of the axis, metres."""
    pose: PoseConfig | None = None
    """Of its middle: the axis along the pose's z, the section's u and v along x and y."""
    length: Annotated[float, Field(ge=MIN_LENGTH, le=1e4)] | None = None
    """With a pose, metres."""
    roll_deg: Finite = 0.0
    """Turn of the section about the axis, degrees."""
    bow: Finite = 0.0
    """Deviation of the axis from its chord at mid-length, towards the section's v, metres."""

    @field_validator("ends")
    @classmethod
    def _apart(cls, value: tuple[Vector3, Vector3] | None) -> tuple[Vector3, Vector3] | None:
        if (
            value is not None
            and (length := float(np.linalg.norm(np.subtract(*value)))) < MIN_LENGTH
        ):
            raise ValueError(f"are {length:g} m apart; a member is at least {MIN_LENGTH:g} m long")
        return value

    @model_validator(mode="after")
    def _placed_once(self) -> MemberConfig:
        if (self.ends is None) == (self.pose is None):
            raise ValueError("needs either ends or a pose")
        if (self.pose is None) != (self.length is None):
            raise ValueError("a pose and a length go together")
        limit = self._length() / 4.0
        if abs(self.bow) > limit:
            raise ValueError(
                f"bow must be at most a quarter of the length, {limit:g}, not {self.bow:g}"
            )
        return self

    def _length(self) -> float:
        return self.length or float(np.linalg.norm(np.subtract(*(self.ends or ()))))

    def member(self, default_name: str) -> Member:
        """Return the member."""
        name, roll = self.name or default_name, float(np.radians(self.roll_deg))
        if self.ends is not None:
            start, end = np.array(self.ends)
            return Member(name, start, end, self.section(), roll, self.bow)
        T = (self.pose or PoseConfig()).transform()
        half = np.array([0.0, 0.0, self._length() / 2.0])
        start, end = T.apply(-half), T.apply(half)
        roll += roll_of(start, end, T.rotation[:, 0])
        return Member(name, start, end, self.section(), roll, self.bow)


class StructureConfig(Node):
    """What all generated structures share."""

    name: str | None = None
    """Stands before the names of its members; what it is without."""
    pose: PoseConfig = PoseConfig()
    """Where it stands."""

    def members(self) -> list[Member]:
        """Return its members in its own frame."""
        raise NotImplementedError


class LatticeTowerConfig(StructureConfig):
    """Tower of four legs on a square, with a square of horizontals and crosses on each storey."""

    height: Positive = 6.0
    """Metres."""
    base: Positive = 1.5
    """Side of the square at its foot, metres."""
    top: Positive = 0.9
    """Side of the square at its top, metres."""
    panels: Annotated[int, Field(ge=1, le=200)] = 6
    """Storeys."""
    legs: SectionConfig = SectionConfig()
    """Their section."""
    horizontals: SectionConfig = SectionConfig()
    """Likewise."""
    diagonals: SectionConfig = SectionConfig()
    """Likewise."""

    def members(self) -> list[Member]:
        """Return its members, the legs standing on z = 0."""
        sections = (part.section() for part in (self.legs, self.horizontals, self.diagonals))
        return generators.lattice_tower(self.height, self.base, self.top, self.panels, *sections)


class BridgeTrussConfig(StructureConfig):
    """Bridge of two trusses along x, tied below and above."""

    length: Positive = 20.0
    """Metres."""
    width: Positive = 1.5
    """From truss to truss, metres."""
    height: Positive = 1.5
    """From the lower to the upper chords, metres."""
    panels: Annotated[int, Field(ge=1, le=200)] = 20
    """Bays of equal length."""
    chords: SectionConfig = SectionConfig()
    """Their section."""
    posts: SectionConfig = SectionConfig()
    """Likewise."""
    diagonals: SectionConfig = SectionConfig()
    """Likewise."""
    crossbeams: SectionConfig = SectionConfig()
    """Likewise."""

    def members(self) -> list[Member]:
        """Return its members, the lower chords at z = 0."""
        parts = (self.chords, self.posts, self.diagonals, self.crossbeams)
        sections = (part.section() for part in parts)
        return generators.bridge_truss(self.length, self.width, self.height, self.panels, *sections)


class AnglePairsConfig(StructureConfig):
    """Pairs of members, end to end along z, each bent by a flat angle."""

    angles_deg: Annotated[
        tuple[Annotated[float, Field(gt=0, lt=180)], ...], Field(min_length=1, max_length=1000)
    ] = (6.0, 10.0, 15.0)
    """Angle of each pair, degrees; 0 would be straight."""
    length: Positive = 1.2
    """Of each member, metres."""
    spacing: Positive = 1.0
    """From pair to pair along y, metres."""
    section: SectionConfig = SectionConfig()
    """Of all members."""

    def members(self) -> list[Member]:
        """Return its members, the joints at z = 0."""
        angles = np.radians(self.angles_deg).tolist()
        return generators.angle_pairs(angles, self.length, self.spacing, self.section.section())


class StarJointConfig(StructureConfig):
    """Members that rise from one joint."""

    count: Annotated[int, Field(ge=2, le=12)] = 4
    """Of the members."""
    length: Positive = 1.2
    """Of each member, metres."""
    section: SectionConfig = SectionConfig()
    """Of all members."""

    def members(self) -> list[Member]:
        """Return its members, the joint at the origin."""
        return generators.star_joint(self.count, self.length, self.section.section())


class ParallelPairsConfig(StructureConfig):
    """Pairs of parallel members along z."""

    distances: Annotated[tuple[Positive, ...], Field(min_length=1, max_length=1000)] = (0.15,)
    """Between the axes of each pair, metres."""
    length: Positive = 2.0
    """Of each member, metres."""
    spacing: Positive = 1.0
    """From pair to pair along y, metres."""
    section: SectionConfig = SectionConfig()
    """Of all members."""

    def members(self) -> list[Member]:
        """Return its members, their middles at z = 0."""
        return generators.parallel_pairs(
            self.distances, self.length, self.spacing, self.section.section()
        )


class PlaneConfig(PoseConfig):
    """A flat rectangle, seen from both sides, its normal along the pose's z."""

    size: Size2 = (10.0, 10.0)
    """Along the pose's x and y, metres."""


class BoxConfig(PoseConfig):
    """A box about the pose's origin."""

    size: Size3
    """Along the pose's axes, metres."""


class SphereConfig(Node):
    """A sphere."""

    centre: Vector3
    """Metres."""
    radius: Positive
    """Metres."""


def _thrice(value: Any) -> Any:
    return [value] * 3 if isinstance(value, int | float) else value


class MeshConfig(PoseConfig):
    """Triangles of a file."""

    file: str
    """STL, OBJ or PLY file, relative to the world's."""
    scale: Annotated[Size3, BeforeValidator(_thrice)] = (1.0, 1.0, 1.0)
    """Metres per unit of the file, one number or one for each axis of it."""


class _OneOf(Node):
    """A mapping with exactly one key, which says what stands below it."""

    @model_validator(mode="before")
    @classmethod
    def _bare_key(cls, data: Any) -> Any:
        """Let a key without a value stand for its defaults."""
        if not isinstance(data, Mapping):
            return data
        return {key: {} if value is None else value for key, value in data.items()}

    @model_validator(mode="after")
    def _one(self) -> _OneOf:
        if len(self.model_fields_set) != 1:
            kinds = ", ".join(type(self).model_fields)
            raise ValueError(f"must hold one of these keys: {kinds}")
        return self

    def kind(self) -> str:
        """Return the key that is given."""
        return next(iter(self.model_fields_set))

    def content(self) -> Any:
        """Return what stands below it."""
        return getattr(self, self.kind())


class GenerateConfig(_OneOf):
    """A parametric structure."""

    lattice_tower: LatticeTowerConfig | None = None
    bridge_truss: BridgeTrussConfig | None = None
    angle_pairs: AnglePairsConfig | None = None
    star_joint: StarJointConfig | None = None
    parallel_pairs: ParallelPairsConfig | None = None


class ClutterConfig(_OneOf):
    """Something that is not a beam."""

    plane: PlaneConfig | None = None
    box: BoxConfig | None = None
    sphere: SphereConfig | None = None
    mesh: MeshConfig | None = None


class LevelConfig(Node):
    """A floor or a ceiling."""

    z: Finite
    """Height, metres."""
    size: Size2 = (10.0, 10.0)
    """Along x and y, metres."""
    centre: tuple[Finite, Finite] = (0.0, 0.0)
    """Metres."""

    def rectangle(self) -> Rectangle:
        """Return the rectangle."""
        return Rectangle(np.array([*self.centre, self.z]), np.array(self.size))


class FloorConfig(LevelConfig):
    """The floor."""

    z: Finite = 0.0


class CeilingConfig(LevelConfig):
    """The ceiling."""

    z: Finite = 4.0


def _switch(value: Any) -> Any:
    """Let true stand for the defaults, and false for nothing."""
    return ({} if value else None) if isinstance(value, bool) else value


class WorldConfig(Node):
    """A world file."""

    name: str | None = None
    """Its name; that of the file without."""
    members: tuple[MemberConfig, ...] = ()
    generate: tuple[GenerateConfig, ...] = ()
    clutter: tuple[ClutterConfig, ...] = ()
    floor: Annotated[FloorConfig | None, BeforeValidator(_switch)] = FloorConfig()
    """true, false, or its height and size."""
    ceiling: Annotated[CeilingConfig | None, BeforeValidator(_switch)] = None
    """Likewise."""
    flight: dict[str, Any] | None = None
    """How to fly through it; see the simulation."""
    sensor: str | None = None
    """Preset, or file, of the camera to fly with."""
