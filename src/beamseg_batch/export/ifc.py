"""Bars as members of a building model, IFC4, by ifcopenshell."""

from __future__ import annotations

import math
import uuid
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from beamseg_batch.bars import Bar, section_name
from beamseg_batch.export.content import Content
from beamseg_batch.extras import load_extra
from beamseg_batch.geometry import FloatArray, normalised
from beamseg_batch.prisms import outline
from beamseg_batch.section import Section
from beamseg_batch.tables import MEMBERS, SEGMENTS

__all__ = ["PROPERTIES", "write_ifc"]

PROPERTIES = "Beamseg_Measurement"
"""Name of the property set that says how well a member is known."""

_LENGTHS = ("sigma_offset", "sigma_end_1", "sigma_end_2", "sigma_radius", "measured_radius")
_FLAGS = ("end_1_seen", "end_2_seen")
_COUNTS = ("n_scans", "n_points")


def write_ifc(content: Content, path: Path) -> int:
    """Write an IfcMember for each bar: profile, placement, how well it is known, what it joins."""
    library = load_extra("ifcopenshell", f"a {path.suffix} file")
    load_extra("ifcopenshell.guid", f"a {path.suffix} file")
    model = _Model(library, content)
    for bar in content.bars:
        model.add(bar)
    model.finish(path.name)
    model.file.write(str(path))
    return len(content.bars)


class _Model:
    """An IFC file in the making."""

    def __init__(self, library: Any, content: Content) -> None:
        self.content = content
        self.library = library
        self.file = library.file(schema="IFC4")
        self.members: dict[int, Any] = {}
        self.profiles: dict[Section, Any] = {}
        self.by_profile: dict[Section, list[Any]] = {}
        self.by_beam: dict[int, list[Any]] = {}
        self.up = self.direction([0.0, 0.0, 1.0])
        self.zero = self.point(np.zeros(3))
        self.contexts = self._contexts()
        self.building = self._building()

    def make(self, kind: str, **values: Any) -> Any:
        return self.file.create_entity(kind, **values)

    def rooted(self, kind: str, key: str, **values: Any) -> Any:
        """Build an entity with an identity: the same for the same results."""
        seed = f"{self.content.run.summary.get('results_sha256')}/{kind}/{key}"
        identity = uuid.uuid5(uuid.NAMESPACE_OID, seed).hex
        return self.make(kind, GlobalId=self.library.guid.compress(identity), **values)

    def point(self, position: FloatArray) -> Any:
        return self.make("IfcCartesianPoint", Coordinates=[float(x) for x in position])

    def direction(self, vector: Any) -> Any:
        return self.make("IfcDirection", DirectionRatios=[float(x) for x in vector])

    def axes(self, position: FloatArray, rotation: FloatArray) -> Any:
        """Axes whose z is the third column of a rotation, and whose x is the first."""
        z, x = self.direction(rotation[:, 2]), self.direction(rotation[:, 0])
        return self.make(
            "IfcAxis2Placement3D", Location=self.point(position), Axis=z, RefDirection=x
        )

    def _contexts(self) -> dict[str, Any]:
        world = self.make("IfcAxis2Placement3D", Location=self.zero)
        whole = self.make(
            "IfcGeometricRepresentationContext",
            ContextType="Model",
            CoordinateSpaceDimension=3,
            Precision=1e-6,
            WorldCoordinateSystem=world,
        )
        parts = {
            name: self.make(
                "IfcGeometricRepresentationSubContext",
                ContextIdentifier=name,
                ContextType="Model",
                ParentContext=whole,
                TargetView=view,
            )
            for name, view in (("Body", "MODEL_VIEW"), ("Axis", "GRAPH_VIEW"))
        }
        return {"Model": whole, **parts}

    def _building(self) -> Any:
        units = [
            self.make("IfcSIUnit", UnitType="LENGTHUNIT", Name="METRE"),
            self.make("IfcSIUnit", UnitType="PLANEANGLEUNIT", Name="RADIAN"),
        ]
        project = self.rooted(
            "IfcProject",
            "project",
            Name="Surveyed structure",
            RepresentationContexts=[self.contexts["Model"]],
            UnitsInContext=self.make("IfcUnitAssignment", Units=units),
        )
        site = self._place("IfcSite", "Site", None)
        building = self._place("IfcBuilding", "Structure", site.ObjectPlacement)
        for whole, part in ((project, site), (site, building)):
            key = part.is_a()
            self.rooted("IfcRelAggregates", key, RelatingObject=whole, RelatedObjects=[part])
        return building

    def _place(self, kind: str, name: str, within: Any) -> Any:
        place = self.make(
            "IfcLocalPlacement",
            PlacementRelTo=within,
            RelativePlacement=self.make("IfcAxis2Placement3D", Location=self.zero),
        )
        return self.rooted(kind, name, Name=name, ObjectPlacement=place, CompositionType="ELEMENT")

    def add(self, bar: Bar) -> None:
        """Add a member; its own z runs along the chord, x and y along the section's u and v."""
        kind = self.content.what.removesuffix("s")
        name = section_name(bar.section)
        placement = self.make(
            "IfcLocalPlacement",
            PlacementRelTo=self.building.ObjectPlacement,
            RelativePlacement=self.axes(bar.start, bar.rotation),
        )
        local = (bar.nodes - bar.start) @ bar.rotation
        shape = self.make(
            "IfcProductDefinitionShape", Representations=[self._axis(local), self._body(bar, local)]
        )
        member = self.rooted(
            "IfcMember",
            str(bar.number),
            Name=f"{kind} {bar.number}",
            ObjectType=name,
            ObjectPlacement=placement,
            Representation=shape,
            Tag=str(bar.number),
            PredefinedType="MEMBER",
        )
        self.members[bar.number] = member
        self.by_profile.setdefault(bar.section, []).append(member)
        self.by_beam.setdefault(bar.beam, []).append(member)
        self._measure(bar, member)

    def _axis(self, local: FloatArray) -> Any:
        line = self.make("IfcPolyline", Points=[self.point(node) for node in local])
        return self._representation("Axis", "Curve3D", [line])

    def _body(self, bar: Bar, local: FloatArray) -> Any:
        """Extrude the profile along the axis, in as many pieces as it has."""
        is_straight = len(local) == 2
        solids = [
            self.make(
                "IfcExtrudedAreaSolid",
                SweptArea=self._profile(bar.section),
                Position=None if is_straight else self._piece(one, other),
                ExtrudedDirection=self.up,
                Depth=float(np.linalg.norm(other - one)),
            )
            for one, other in pairwise(local)
        ]
        return self._representation("Body", "SweptSolid", solids)

    def _piece(self, one: FloatArray, other: FloatArray) -> Any:
        """Axes of a straight piece of a bowed member."""
        w = normalised(other - one)
        u = normalised(np.array([w[2], 0.0, -w[0]]))  # across it, in the plane of x and z
        return self.axes(one, np.column_stack([u, np.cross(w, u), w]))

    def _representation(self, context: str, kind: str, items: list[Any]) -> Any:
        return self.make(
            "IfcShapeRepresentation",
            ContextOfItems=self.contexts[context],
            RepresentationIdentifier=context,
            RepresentationType=kind,
            Items=items,
        )

    def _profile(self, section: Section) -> Any:
        if section not in self.profiles:
            self.profiles[section] = self._new_profile(section)
        return self.profiles[section]

    def _new_profile(self, section: Section) -> Any:
        """Profile of a section about its centre of area; IFC's own are about their middle."""
        common = {"ProfileType": "AREA", "ProfileName": section_name(section)}
        corners = outline(section)
        middle = (corners.min(axis=0) + corners.max(axis=0)) / 2.0
        place = self.make(
            "IfcAxis2Placement2D",
            Location=self.point(middle),
            RefDirection=self.direction([1.0, 0.0]),
        )
        if section.shape == "round":
            return self.make("IfcCircleProfileDef", **common, Radius=section.radius)
        w, h, web, flange = section.width, section.height, section.web, section.flange
        common["Position"] = place
        if section.shape == "square":
            return self.make("IfcRectangleProfileDef", **common, XDim=w, YDim=h)
        plates = {"WebThickness": web, "FlangeThickness": flange}
        if section.shape == "i":
            return self.make(
                "IfcIShapeProfileDef", **common, OverallWidth=w, OverallDepth=h, **plates
            )
        if section.shape == "c":
            return self.make("IfcUShapeProfileDef", **common, Depth=h, FlangeWidth=w, **plates)
        if math.isclose(web, flange, rel_tol=1e-9):
            return self.make("IfcLShapeProfileDef", **common, Depth=h, Width=w, Thickness=web)
        del common["Position"]  # legs of different thickness: IFC's angle has one
        ring = [self.point(corner) for corner in (*corners, corners[0])]
        line = self.make("IfcPolyline", Points=ring)
        return self.make("IfcArbitraryClosedProfileDef", **common, OuterCurve=line)

    def _measure(self, bar: Bar, member: Any) -> None:
        """Say how long a member is."""
        length = self.make("IfcQuantityLength", Name="Length", LengthValue=bar.length)
        key = f"{bar.number}"
        quantities = self.rooted(
            "IfcElementQuantity", key, Name="Qto_MemberBaseQuantities", Quantities=[length]
        )
        self._define(f"{key}/quantities", [member], quantities)

    def _describe(self, beam: int, members: list[Any]) -> None:
        """Say how well a beam is known, once for all of its members."""
        columns = self.content.tables[SEGMENTS.name]
        values: list[tuple[str, str, Any]] = [("beam", "IfcInteger", beam)]
        values += [(name, "IfcLengthMeasure", float(columns[name][beam])) for name in _LENGTHS]
        angle = math.radians(float(columns["sigma_angle_deg"][beam]))
        values.append(("sigma_angle", "IfcPlaneAngleMeasure", angle))
        values += [(name, "IfcCountMeasure", int(columns[name][beam])) for name in _COUNTS]
        values += [(name, "IfcBoolean", columns[name][beam]) for name in _FLAGS]
        single = [
            self.make(
                "IfcPropertySingleValue",
                Name=name,
                NominalValue=self.make(kind, wrappedValue=value),
            )
            for name, kind, value in values
            if value is not None and not math.isnan(value)
        ]
        properties = self.rooted("IfcPropertySet", str(beam), Name=PROPERTIES, HasProperties=single)
        self._define(f"{beam}/properties", members, properties)

    def _define(self, key: str, members: list[Any], definition: Any) -> None:
        self.rooted(
            "IfcRelDefinesByProperties",
            key,
            RelatedObjects=members,
            RelatingPropertyDefinition=definition,
        )

    def finish(self, name: str) -> None:
        """Put the members into the building, give them their profiles and say what they join."""
        if self.members:
            self.rooted(
                "IfcRelContainedInSpatialStructure",
                "members",
                RelatedElements=list(self.members.values()),
                RelatingStructure=self.building,
            )
        for beam, members in self.by_beam.items():
            self._describe(beam, members)
        for number, (section, members) in enumerate(self.by_profile.items()):
            profile = self.make(
                "IfcMaterialProfile", Name=section_name(section), Profile=self.profiles[section]
            )
            profiles = self.make("IfcMaterialProfileSet", MaterialProfiles=[profile])
            usage = self.make("IfcMaterialProfileSetUsage", ForProfileSet=profiles)
            self.rooted(
                "IfcRelAssociatesMaterial",
                str(number),
                RelatedObjects=members,
                RelatingMaterial=usage,
            )
        if self.content.what == "members":
            self._connect()
        self._head(name)

    def _connect(self) -> None:
        """Connect the members of each joint with its first one."""
        columns = self.content.tables[MEMBERS.name]
        first: dict[float, Any] = {}
        for number, member in self.members.items():
            for joint in {columns["joint_1"][number], columns["joint_2"][number]}:
                if not math.isnan(joint) and first.setdefault(joint, member) is not member:
                    self.rooted(
                        "IfcRelConnectsElements",
                        f"{joint:.0f}/{number}",
                        Name=f"joint {joint:.0f}",
                        RelatingElement=first[joint],
                        RelatedElement=member,
                    )

    def _head(self, name: str) -> None:
        from beamseg_batch import __version__

        header = self.file.header
        header.file_description.description = ("ViewDefinition [ReferenceView_V1.2]",)
        header.file_name.name = name
        header.file_name.originating_system = f"beamseg-batch {__version__}"
