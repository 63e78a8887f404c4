"""Commands of `unicon` on recordings and many runs, found by entry points."""
