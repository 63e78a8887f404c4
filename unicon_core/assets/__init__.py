"""Assets: other people's models and policies, from their public repositories, checked and licensed.

    unicon assets fetch g1_29dof      into the user's cache, where `assets:` of configurations looks

`config/assets.yaml` has what there is: of each file its repository, commit, SHA-256 and licence.
"""
