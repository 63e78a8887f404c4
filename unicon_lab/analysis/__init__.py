"""Analysis of the reality gap: two recordings brought together, compared and shown as a report."""
