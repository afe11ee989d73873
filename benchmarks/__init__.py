"""What the README claims, measured again: `python -m benchmarks [NAME...]`. One benchmark = one file."""

from __future__ import annotations

import os
from pathlib import Path

from benchmarks.base import ROOT, Benchmark
from capture_cli.common.registry import Registry

MACHINES = Path(__file__).with_name("machines")
# of real logs, each with a README that says where it is from
REAL_DATA = Path(os.environ.get("CAPTURE_REAL_DATA", ROOT / ".." / "shared" / "data"))
EMPS = ROOT / "docs" / "examples" / "emps"
REGISTRY: Registry[Benchmark] = Registry("benchmarks", "Benchmark", "benchmark")
