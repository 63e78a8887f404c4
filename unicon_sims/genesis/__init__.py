"""Genesis as a platform: MuJoCo's compiled model goes to it, so masses and frames are the same."""
