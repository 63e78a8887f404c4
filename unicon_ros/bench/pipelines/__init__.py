"""The pipelines that `unicon bench latency` compares, one file each; every one is a process."""
