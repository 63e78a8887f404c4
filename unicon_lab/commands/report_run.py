"""`unicon report-run BAG`: an anonymous report of a run for the ledger of evidence, and its check.

unicon report-run walk.mcap                                     of a stand-in, if anybody's
unicon report-run walk.mcap --hardware --sign ~/.ssh/id_ed25519
unicon report-run --verify go2-2026-12-01.yaml --bag walk.mcap
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from unicon_base import UniconError
from unicon_ros.cli.options import EXAMPLES, argument, command, flag


def _report_run(arguments: argparse.Namespace) -> int:
    if (arguments.recording is None) == (arguments.verify is None):
        raise UniconError("report-run: give the recording BAG of a run, or --verify FILE")
    return _verify(arguments) if arguments.verify else _write(arguments)


def _write(arguments: argparse.Namespace) -> int:
    from unicon_lab.evidence_report import report as reports

    report = reports.report_of(arguments.recording, arguments.hardware)
    robot = "-".join(report["robots"]) if isinstance(report["robots"], dict) else "robot"
    out = arguments.out or Path(f"{robot}-{report['date']}.yaml")
    reports.refuse_existing(out, arguments.force)
    text = reports.text_of(report)
    signature = reports.sign(text, arguments.sign) if arguments.sign is not None else b""
    print(text)
    sys.stdout.flush()  # what nobody could read is not written
    reports.write_report(out, text, signature)
    print(f"report     {out}: look through it before you share it; nothing was sent")
    told = f"{reports.signature_of(out)}" if signature else "none; --sign KEY makes one"
    print(f"signature  {told}")
    return 0


def _verify(arguments: argparse.Namespace) -> int:
    from unicon_lab.evidence_report import report as reports
    from unicon_lab.recording import open_record

    path, bag = arguments.verify, arguments.bag
    report = reports.read_report(path)
    if bag is not None:
        if reports.recording_of(open_record(bag)) != report.get("recording_sha256"):
            raise UniconError(f"{path} is of another recording than {bag}; give the one it is of")
        print(f"{bag} is the recording of it")
    print(reports.signed_by(path, arguments.allowed_signers))
    return 0


add = command(
    "report-run",
    _report_run,
    "report a run on hardware, without anybody's name, for the ledger of evidence",
    __doc__,
    argument("recording", "BAG", "of the run", nargs="?", type=Path),
    flag("--hardware", "say that it was a robot of metal"),
    argument("--out", "FILE", "the report (default: ROBOT-DATE.yaml)", type=Path),
    flag("--force", "overwrite it"),
    argument("--sign", "KEY", "sign it with your SSH key, as FILE.sig", type=Path),
    argument("--verify", "FILE", "check the signature of a report", type=Path),
    argument("--allowed-signers", "FILE", "of --verify: keys that count, OpenSSH's", type=Path),
    argument("--bag", "BAG", "of --verify: its recording", type=Path),
    **EXAMPLES,
)
