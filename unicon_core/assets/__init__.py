"""Assets: other people's models and policies, from their public repositories, checked and licensed.

    unicon assets fetch g1_29dof      into the user's cache, where `assets:` of configurations looks

`config/assets.yaml` has what there is: of each file its repository, commit, SHA-256 and licence.
"""

from unicon_core.assets.fetching import Got, fetch
from unicon_core.assets.manifest import (
    Asset,
    AssetFile,
    Source,
    asset_folder,
    load_assets,
    named,
    wrong_files,
)

__all__ = [
    "Asset",
    "AssetFile",
    "Got",
    "Source",
    "asset_folder",
    "fetch",
    "load_assets",
    "named",
    "wrong_files",
]
