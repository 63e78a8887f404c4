"""`unicon serve POLICY`: runs the network of a policy for robots that ask over the network.

unicon serve go2_velocity                                      # this machine alone
unicon serve go2_velocity --bind 'tcp://*:5560' --keys keys    # others, with keys

The workflow on the robot says policies: {walk: {path: go2_velocity, remote: {address:
tcp://HOST:5560, keys: keys}}}. It has the same policy: both ends compare a contract hash.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from unicon_base import UniconError
from unicon_ros.cli.console import Console
from unicon_ros.cli.options import EXAMPLES, argument, command

EVERY = 1.0
"""Of the status line in [s]."""


def serve(arguments: argparse.Namespace) -> int:
    """Run the command until a signal ends it; exit status 0."""
    import numpy as np

    from unicon_core.policies.load import load_network
    from unicon_core.policies.networks.remote_server import PolicyServer
    from unicon_core.runtime import percentiles
    from unicon_core.signals import SIGNALS
    from unicon_core.states.backends.zmq_socket import is_exposed

    if arguments.keys is None and is_exposed(arguments.bind):
        raise UniconError(
            f"--bind {arguments.bind}: other machines reach it; make keys (docs/howto/zmq.md) and "
            "give --keys FOLDER, or bind 127.0.0.1"
        )
    contract = load_network(arguments.policy, arguments.provider)
    server = PolicyServer(contract, arguments.bind, arguments.keys)
    console, counted = Console(), 0

    def inference() -> str:
        found = percentiles(np.array(server.times) * 1e3)
        return f"p50 {found['p50']:.2f} ms, p99 {found['p99']:.2f} ms"

    def look() -> None:
        nonlocal counted
        if console.due(EVERY):
            rate, counted = (server.answered - counted) / EVERY, server.answered
            console.status({"answers/s": f"{rate:.0f}", "inference": inference()})

    try:
        with SIGNALS.guard(server.stop):
            SIGNALS.check()
            print(f"address  {server.address}\nkey      {server.key or 'none'}")
            print(f"hash     {server.digest.hex()}", flush=True)
            server.run(look)
    finally:
        console.close()
        server.close()
    print(f"answers  {server.answered}, inference {inference()}")
    return 0


add = command(
    "serve",
    serve,
    "run a policy's network for robots that ask",
    __doc__,
    argument("policy", "POLICY", "name in config/policies/, a folder or file"),
    argument("--provider", "NAME", "where it runs: cpu, cuda or tensorrt, instead of the policy's"),
    argument("--bind", "ADDRESS", "where it listens (%(default)s)", default="tcp://127.0.0.1:5560"),
    argument("--keys", "FOLDER", "its CURVE keys, for other machines", type=Path),
    **EXAMPLES,
)
