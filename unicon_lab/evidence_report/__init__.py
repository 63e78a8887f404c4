"""Reports of runs for the ledger of evidence: what ran, and nobody's name; for `unicon report-run`.

Each field is made anew of what a recording has, nothing is copied whole, and nothing is sent.
"""
