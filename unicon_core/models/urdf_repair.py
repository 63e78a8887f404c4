"""Repairs in public URDF files what ROS reads over and MuJoCo refuses, for the model loader."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from unicon_core.errors import ModelError

_ONCE = ("origin", "geometry", "material", "inertial", "mass", "inertia")
_TERMS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def repaired_urdf(path: Path, notes: list[str]) -> str | None:
    """Return the text of a URDF with its mistakes mended, None where there are none.

    Mended are elements that stand twice (two materials in the visuals of Unitree's Go2), inertias
    that no body can have (Robotera's XHand repeats one figure six times; of a camera of ANYbotics'
    ANYmal C two principal moments sum to less than the third), and shapes without an extent.

    Args:
        path: the file.
        notes: gets one line for each kind of mistake.

    Raises:
        ModelError: the file is not XML, or declares entities: no robot needs any, and they may grow
            without end or name other files.
    """
    try:
        raw = path.read_bytes()
        if b"\0" in raw:  # else entities could hide in another encoding, which MuJoCo cannot read
            raise ModelError(f"model {path}: it is not UTF-8; save it as that")
        text = raw.decode("utf-8-sig", "replace")
        if "<!ENTITY" in text or "<!DOCTYPE" in text:
            raise ModelError(f"model {path}: it has a DOCTYPE or entities; take them out")
        root = ET.fromstring(text)  # whatever encoding it declares: MuJoCo reads UTF-8
    except (ET.ParseError, OSError, ValueError, LookupError) as error:
        raise ModelError(f"model {path}: {error}; correct the file") from error
    twice = _drop_repeated(root)
    bodies = _mend_inertias(root)
    flat = _drop_flat(root)
    if twice:
        notes.append(f"{len(twice)} elements stand twice in the URDF (first: {twice[0]})")
    if bodies:
        notes.append(
            f"the inertia of {', '.join(bodies)} is none that a body can have: "
            "its largest figure stands for all axes"
        )
    if flat:
        notes.append(f"shapes without an extent are left out: {', '.join(flat)}")
    try:
        return ET.tostring(root, encoding="unicode") if twice or bodies or flat else None
    except RecursionError as error:
        raise ModelError(f"model {path}: its elements are nested too deep") from error


def _drop_repeated(root: ET.Element) -> list[str]:
    dropped = []
    for parent in root.iter():
        if parent.tag not in ("visual", "collision", "inertial", "link"):
            continue
        seen: set[str] = set()
        for child in list(parent):
            if child.tag in _ONCE and child.tag in seen:
                parent.remove(child)
                dropped.append(f"{child.tag} of a {parent.tag}")
            seen.add(child.tag)
    return dropped


def _mend_inertias(root: ET.Element) -> list[str]:
    mended = []
    for link in root.findall("link"):
        inertia = link.find("inertial/inertia")
        if inertia is None:
            continue
        try:
            xx, yy, zz, xy, xz, yz = (float(inertia.get(term, "0")) for term in _TERMS)
        except ValueError:
            continue  # MuJoCo names the line
        matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if not np.isfinite(matrix).all():
            continue  # MuJoCo refuses it
        if not matrix.any():
            continue  # MuJoCo takes it from mass and shapes, or says so
        small, middle, large = np.linalg.eigvalsh(matrix)
        if small > 1e-9 * abs(matrix).max() and small + middle >= large:
            continue
        for term in _TERMS:
            inertia.set(term, repr(float(abs(matrix).max())) if term[1] == term[2] else "0")
        mended.append(str(link.get("name")))
    return mended


def _drop_flat(root: ET.Element) -> list[str]:
    """Take shapes with a radius, length or edge of 0 out; return what was dropped."""
    dropped = []
    for link in root.findall("link"):
        for element in (*link.findall("visual"), *link.findall("collision")):
            shape = element.find("geometry/*")
            sizes = () if shape is None else map(shape.get, ("radius", "length", "size"))
            try:
                flat = any(0.0 in map(float, size.split()) for size in sizes if size)
            except ValueError:
                continue  # MuJoCo names the line
            if shape is not None and flat:
                link.remove(element)
                dropped.append(f"{shape.tag} in a {element.tag} of {link.get('name')}")
    return dropped
