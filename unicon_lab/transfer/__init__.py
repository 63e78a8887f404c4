"""Transfer: one workflow on several simulators, compared run by run with the first."""
