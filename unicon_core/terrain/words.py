"""What a scene says of the ground: kinds of terrain and their figures, for `scene.terrain`.

scene: {terrain: {stairs: {rise: 0.1, run: 0.3}}}
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Annotated, Any

from unicon_base import AnyDict, AnyMapping, PlatformError, alternatives
from unicon_base.schema.marks import Checked, Within
from unicon_base.schema.read import refuse
from unicon_base.schema.records import record_of
from unicon_base.schema.types import Mistakes

FLAT = "flat"


def _wrong_ends(said: Any) -> str:
    if not isinstance(said, tuple) or said[0] <= said[1]:
        return ""
    return f"is {list(said)}; write [low, high]"


_RISES = Checked(_wrong_ends)


@dataclass(frozen=True, kw_only=True)
class Kind:
    """What all kinds have.

    Attributes:
        extent: edge of the square that it covers, the start amid.
        flat: edge of the square around the start that stays flat.
    """

    extent: Annotated[float, Within(4.0, 200.0, "m")] = 40.0
    flat: Annotated[float, Within(1.0, 20.0, "m")] = 2.0

    def __post_init__(self) -> None:
        """Refuse ground that is flat all over.

        Raises:
            PlatformError: it is.
        """
        if self.flat >= self.extent:
            raise PlatformError(
                f"flat is {self.flat:g} m, and extent {self.extent:g}; give a larger extent"
            )


@dataclass(frozen=True, kw_only=True)
class Drawn(Kind):
    """What kinds have that draw.

    Attributes:
        seed: of what is drawn; the scene's unless given.
    """

    seed: Annotated[int | None, Within(0)] = None


@dataclass(frozen=True, kw_only=True)
class Slope(Kind):
    """A plane.

    Attributes:
        angle: in front of the start; below 0 it falls.
    """

    angle: Annotated[float, Within(-0.8, 0.8, "rad")] = 0.1


@dataclass(frozen=True, kw_only=True)
class Pyramid(Kind):
    """Steps on all four sides.

    Attributes:
        rise: height of a step; below 0 they go down first.
        run: depth of a step.
        steps: how many, then a landing.
    """

    rise: Annotated[float, Within(-0.5, 0.5, "m")] = 0.1
    run: Annotated[float, Within(0.1, 10.0, "m")] = 0.3
    steps: Annotated[int, Within(1, 1000)] = 10


@dataclass(frozen=True, kw_only=True)
class Stairs(Pyramid):
    """Flights of steps in front of the start.

    Attributes:
        landing: before they go the other way.
    """

    landing: Annotated[float, Within(0.1, 20.0, "m")] = 1.0


@dataclass(frozen=True, kw_only=True)
class Rough(Drawn):
    """A field of heights.

    Attributes:
        height: between the lowest and the highest point.
        spacing: between two points, in x and in y.
    """

    height: Annotated[float, Within(0.0, 1.0, "m")] = 0.04
    spacing: Annotated[float, Within(0.02, 5.0, "m")] = 0.1


Factor = Annotated[float, Within(0.0, 20.0)]
Tall = Annotated[float, Within(0.0, 2.0, "m")]
Wide = Annotated[float, Within(0.01, 10.0, "m")]


@dataclass(frozen=True, kw_only=True)
class Patches(Drawn):
    """Tiles of one height.

    Attributes:
        friction: factor on that of the floor, drawn between two.
        size: edge of a patch.
    """

    friction: Annotated[tuple[Factor, Factor] | Factor, _RISES] = (0.2, 1.0)
    size: Annotated[float, Within(0.1, 20.0, "m")] = 1.0


@dataclass(frozen=True, kw_only=True)
class Obstacles(Drawn):
    """Boxes on the floor.

    Attributes:
        height: of a box, drawn between two.
        size: of its edges, drawn between two.
        density: boxes on a square metre.
    """

    height: Annotated[tuple[Tall, Tall] | Tall, _RISES] = (0.02, 0.08)
    size: Annotated[tuple[Wide, Wide] | Wide, _RISES] = (0.2, 0.6)
    density: Annotated[float, Within(0.0, 20.0, "1/m²")] = 0.5


@dataclass(frozen=True, kw_only=True)
class Gaps(Kind):
    """Gaps across the way.

    Attributes:
        width: of a gap.
        run: of the ground between two.
        depth: of a gap.
    """

    width: Annotated[float, Within(0.0, 5.0, "m")] = 0.1
    run: Annotated[float, Within(0.05, 20.0, "m")] = 0.6
    depth: Annotated[float, Within(0.01, 5.0, "m")] = 0.3


_KINDS = (Slope, Stairs, Pyramid, Rough, Patches, Obstacles, Gaps)
KINDS: dict[str, type[Kind]] = {each.__name__.lower(): each for each in _KINDS}
"""Word of a kind of terrain to its figures."""


@dataclass(frozen=True)
class Terrain:
    """A kind of terrain with all of its figures.

    Attributes:
        kind: of `KINDS`.
        figures: name to value, or to the lowest and highest one.
        seed: of what is drawn.
    """

    kind: str
    figures: AnyMapping
    seed: int = 0

    def __getitem__(self, name: str) -> Any:
        return self.figures[name]


def read_terrain(said: object, seed: int) -> Terrain | None:
    """Return what a scene says of the ground, None for flat.

    Args:
        said: a kind, or a kind to its figures.
        seed: of the scene, for a terrain that names none.

    Raises:
        PlatformError: there is no such kind or figure, or a value is wrong.
    """
    known = (FLAT, *KINDS)
    if isinstance(said, Mapping) and len(said) != 1:
        named = " and ".join(map(str, said)) or "nothing"
        raise PlatformError(f"scene.terrain names {named}; give one of {', '.join(known)}")
    kind, given = next(iter(said.items())) if isinstance(said, Mapping) else (said, None)
    if kind not in known:
        raise PlatformError(
            f"scene.terrain is {str(kind)[:60]!r}; {alternatives(str(kind), known)}; or put other "
            "ground into a model (scene: {model: PATH})"
        )
    given = {} if given is None else given
    if kind == FLAT:
        if given:
            raise PlatformError(f"scene.terrain.flat has no figures; write terrain: {FLAT}")
        return None
    mistakes = Mistakes()
    found = record_of(KINDS[kind]).read(given, ("scene", "terrain", kind), mistakes)
    refuse(mistakes, lambda _, text: PlatformError(text), f"scene.terrain.{kind}")
    pairs = [each.name for each in fields(found) if isinstance(each.default, tuple)]
    values: AnyDict = {
        name: (value, value) if name in pairs and not isinstance(value, tuple) else value
        for name, value in asdict(found).items()
    }
    own = values.pop("seed", None)
    return Terrain(kind, values, seed if own is None else own)
