"""`python -m unicon_ros`: the same as the console script `unicon`."""

from unicon_ros.cli.main import main

if __name__ == "__main__":
    raise SystemExit(main())
