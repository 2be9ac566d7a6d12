"""README's blocks of code, run word for word, and what they print held against what it shows."""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path
from typing import Any

README = Path(__file__).parent.parent / "README.md"
BLOCK = re.compile(r"```python\n(.*?)```\n\n```\n(.*?)```", re.DOTALL)
NUMBER = re.compile(r"[0-9.]+e[+-][0-9]+")


def run() -> None:
    """One after the other, as in one file."""
    names: dict[str, Any] = {}
    blocks = BLOCK.findall(README.read_text(encoding="utf-8"))
    assert len(blocks) == 3
    for code, shown in blocks:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(code, "README.md", "exec"), names)
        pairs = zip(shown.splitlines(), printed.getvalue().splitlines(), strict=True)
        for said, line in pairs:
            assert NUMBER.sub("", said) == NUMBER.sub("", line), (said, line)
            for a, b in zip(*(map(float, NUMBER.findall(x)) for x in (said, line))):
                # another CPU rounds otherwise; drift stays within a factor
                assert abs(a - b) <= max(0.5 * a, 1e-14), (said, line)
