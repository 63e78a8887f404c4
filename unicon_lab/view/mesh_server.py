"""MeshServer: gives Foxglove the files that the robot_description it got names, and no others.

Foxglove asks a server for `package:` alone, and its own browser for `file:`, which may be on
another machine. So `file:///PATH` is told as `package://unicon/PATH`.
"""

from __future__ import annotations

import xml.etree.ElementTree as Xml
from contextlib import suppress
from pathlib import Path
from urllib.parse import unquote, urlsplit

from unicon_base.errors import UniconError
from unicon_base.packages import package_file
from unicon_lab.recording.recorded_topics import string_message

SERVED = "package://unicon"


class MeshServer:
    """Has no file before `offered`."""

    def __init__(self) -> None:
        self._files: dict[str, Path] = {}

    def offered(self, message: bytes) -> bytes:
        """Return a robot_description as clients get it; from then on its meshes are given out.

        Args:
            message: std_msgs/String as CDR: 8 bytes, the text and a NUL.
        """
        root = Xml.fromstring(message[8:-1].decode())
        for mesh in root.iter("mesh"):
            uri = mesh.get("filename", "")
            path = urlsplit(uri).path
            with suppress(UniconError):  # its package has gone
                if uri.startswith("file:"):
                    file, uri = Path(unquote(path)), f"{SERVED}{path}"
                else:
                    file = package_file(uri, "mesh")
                self._files[uri] = file
            mesh.set("filename", uri)
        return string_message('<?xml version="1.0"?>\n' + Xml.tostring(root, encoding="unicode"))

    def fetch(self, uri: str) -> bytes | None:
        """Return the bytes of a file, None where it is not one of those; in threads of the server.

        Args:
            uri: as it stands in the description, letter by letter.
        """
        file = self._files.get(uri)
        try:
            return None if file is None else file.read_bytes()
        except OSError:
            return None
