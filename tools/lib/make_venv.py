"""Creates `.venv/` with everything in it, for `make venv` and for nobody else.

Runs under whatever python3 the machine has, so that a Python that is too old gets a clear line and
not a syntax error: keep this file free of syntax newer than Python 3.6.
"""

import argparse
import ast
import os
import platform
import subprocess
import sys

OLDEST = (3, 10)
# What the package itself needs and what develops it; the wheels of ROS come on top where they run.
EXTRAS = [
    "sim",
    "sim-pybullet",
    "bags",
    "zmq",
    "plots",
    "pages",
    "view",
    "video",
    "foxglove",
    "ik",
    "webxr",
    "sweep",
    "lerobot",
    "completion",
    "hw-unitree",
    "hw-arx",
    "test",
    "dev",
]
# ros-wheels-bootstrapper starts Python a second time with a library path of its own venv and leaves
# both variables to every child process; in another venv they load the wrong libraries.
BOOTSTRAP_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
# Settings of pip, and uv's variable for each (docs.astral.sh/uv/reference/environment); both take
# several values with spaces between them.
UV_SETTINGS = {
    "index-url": "UV_DEFAULT_INDEX",
    "extra-index-url": "UV_INDEX",
    "find-links": "UV_FIND_LINKS",
    "constraint": "UV_CONSTRAINT",
}
# What uv does by itself or does not need.
UV_NEEDS_NOT = ("cert", "default-timeout", "timeout", "disable-pip-version-check", "cache-dir")


def obstacle(version, has_venv):
    """Return why no venv can be made, in one line with the remedy, or None.

    Args:
        version: the interpreter's version, such as (3, 9).
        has_venv: whether the modules venv and ensurepip import.
    """
    if tuple(version[:2]) < OLDEST:
        return (
            f"python3 is {version[0]}.{version[1]}, unicon_ros needs 3.10 or newer: install one "
            "and run 'make venv PYTHON=python3.12'"
        )
    if not has_venv:
        return (
            "python3 lacks the venv module: install it ('sudo apt install python3-venv' on Debian "
            "and Ubuntu) and run 'make venv' again"
        )
    return None


def plan(ros_distro, system, machine, ros_numpy):
    """Return how to make the venv: (arguments of venv, extras, constraints, a note or None).

    Args:
        ros_distro: `$ROS_DISTRO` of a sourced ROS installation, or None.
        system: as `platform.system()` says it.
        machine: as `platform.machine()` says it.
        ros_numpy: the version of the NumPy that the sourced ROS was built with, or None.
    """
    if ros_distro:
        # A ROS built against NumPy 1 crashes on 2: its own NumPy stays in charge.
        major = (ros_numpy or "").split(".")[0]
        constraints = ["numpy<2"] if major == "1" else []
        note = f"ROS {ros_distro} is sourced: its rclpy is used, the wheels are left out"
        return ["--system-site-packages"], EXTRAS, constraints, note
    if (system, machine) != ("Linux", "x86_64"):
        note = (
            f"no ROS wheels exist for {system} {machine}: for --ros, source a ROS 2 installation "
            "(such as '. /opt/ros/jazzy/setup.sh') and run 'make clean-venv venv'"
        )
        return [], EXTRAS, [], note
    return [], [*EXTRAS, "ros"], [], None


def clean_environment(environ):
    """Return the environment for the new venv's Python, without another venv's library path."""
    env = dict(environ)
    if env.pop(BOOTSTRAP_GUARD, None):
        env.pop("LD_LIBRARY_PATH", None)
    return env


def uv_environment(pip_config):
    """Return uv's variables for pip's settings; None where it has no equal of one of them.

    Args:
        pip_config: as `pip config list` prints it, such as `global.index-url='https://…'`.
    """
    found = {"UV_INDEX_STRATEGY": "unsafe-best-match", "UV_SYSTEM_CERTS": "1"}  # as pip does
    for line in reversed(pip_config.splitlines()):  # pip's variables come first, and win
        name, _, value = line.partition("=")
        key = name.rpartition(".")[2]
        if key in UV_SETTINGS:
            separator = "," if key == "find-links" else " "
            found[UV_SETTINGS[key]] = separator.join(ast.literal_eval(value).split())
        elif key not in UV_NEEDS_NOT:
            return None
    return found


def install(python, arguments, env, with_uv):
    """Install with uv, which takes a quarter of the time, else with pip; return the exit status."""
    pip = [python, "-m", "pip", "--disable-pip-version-check"]
    config = subprocess.run([*pip, "config", "list"], env=env, stdout=subprocess.PIPE)
    settings = uv_environment(config.stdout.decode()) if with_uv else None
    if settings is not None and not subprocess.call([*pip, "install", "--quiet", "uv"], env=env):
        uv = os.path.join(os.path.dirname(python), "uv")
        command = [uv, "pip", "install", "--quiet", "--python", python, *arguments]
        if not subprocess.call(command, env={**env, **settings}):
            return 0
        print("make venv: uv failed (see above); pip tries it")
        sys.stdout.flush()
    return subprocess.call([*pip, "install", "--quiet", *arguments], env=env)


def has_modules(*names):
    """Return whether all these modules import."""
    try:
        for name in names:
            __import__(name)
    except ImportError:
        return False
    return True


def numpy_version():
    """Return the version of this Python's NumPy, or None."""
    try:
        import numpy
    except ImportError:
        return None
    return numpy.__version__


def main():
    """Create or update the venv; exit 1 with one line where that cannot work."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", help="where the venv goes")
    folder = parser.parse_args().folder

    problem = obstacle(sys.version_info, has_modules("venv", "ensurepip"))
    if problem:
        sys.exit("make venv: " + problem)
    ros_distro = os.environ.get("ROS_DISTRO")
    venv_args, extras, constraints, note = plan(
        ros_distro, platform.system(), platform.machine(), numpy_version()
    )
    env = clean_environment(os.environ)
    python = os.path.join(folder, "bin", "python")
    if not os.path.exists(python):
        made = subprocess.run([sys.executable, "-m", "venv", *venv_args, folder], env=env)
        if made.returncode:
            sys.exit(f"make venv: {folder} cannot be made (see above): mend that and try again")
    package = ".[{}]".format(",".join(extras))
    print(f"make venv: installing {package} and what it needs; this takes a minute or two")
    sys.stdout.flush()
    # uv does not look at the packages of a sourced ROS.
    if install(python, ["--editable", package, *constraints], env, with_uv=not venv_args):
        sys.exit("make venv: pip failed (see above): mend that and run 'make venv' again")
    if note:
        print("make venv: " + note)


if __name__ == "__main__":
    main()
