"""Wrong and hostile study files: each is a study, or a StudyError with the reason."""

from __future__ import annotations

import json
import random
import resource
import tempfile
import time
import tomllib
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from lierb.errors import StudyError
from lierb.studies.description.study import Study
from lierb.studies.description.study_file import LONGEST_STUDY
from lierb.studies.storage.parts import part_size

EXAMPLES = Path(__file__).parents[2] / "examples"
MOST_SECONDS = 20.0  # of a file, of this process's own time: what takes longer hangs
MOST_MEMORY = 512 * 2**20  # that a campaign may add, for the largest of its files
MOST_TOLD = 5000  # characters of a message
ROUND_TRIPS = 4  # of the studies one in so many is written and read again

EVERY_KEY = """
name = "all"
[body]
solid = "box"
size = [0.1, 0.2, 0.3]
density = 2700.0
[joint]
type = "from_rows"
rows = ["d1", "d2", "d3"]
body_frame = [[0, -1, 0, 0.1], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
ground_frame = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
[problem]
gravity = [0, 0, -9.81]
[[problem.forces]]
type = "constant_wrench"
force = [0.0, 0.0, 1.0]
frame = "body"
[[problem.forces]]
type = "spring_damper"
name = "a.b"
stiffness = 10.0
damping = 0.1
length = 0.2
[initial]
rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
place = [0, 0, 0]
omega = [0.0, 0.0, 1.0]
[sample]
n = 3
seed = 0
method = "random"
[sample.problem]
gravity = { distribution = "values", values = [[0, 0, -9.81], [0, 0, -1.62]] }
[sample.body.density]
distribution = "truncated_normal"
mean = 2700.0
std = 100.0
low = 2000.0
high = inf
[sample.initial.omega]
distribution = "direction"
length = { distribution = "uniform", low = 1.0, high = 2.0 }
[sample.forces."a.b"]
stiffness = { distribution = "log_normal", median = 10.0, sigma = 0.1 }
[integrate]
cspace = ["SE3"]
method = "RK4"
dt = [0.1, 0.05]
t0 = 0.0
t_end = 1.0
update = "local"
solver = "auto"
save_every = 5
measure_every = 1
record = ["state", "energy"]
[output]
part = 10
compression = "zstd"
"""

# The same with steps of each trajectory's own.
EVERY_KEY_OF_TIME = f"""{EVERY_KEY.partition("[integrate]")[0]}
[integrate]
cspace = ["SE3", "SO3xR3"]
method = ["Tsit5"]
rtol = [1e-6, 1e-9]
dt = 0.01
dt_min = 1e-9
dt_max = 0.5
max_steps = 1e6
t0 = 0.0
t_end = 1.0
record = ["state"]
[integrate.atol]
rotation = 1e-9
omega = 1e-9
[integrate.save_at]
every = 0.1
from = 0.5
to = 1.0
"""

NASTY = (  # values as a file has them
    "0", "-0", "-0.0", "1", "-1", "3", "1e-320", "1e308", "-1e308", "1e400", "inf", "-inf", "nan",
    "1e18", "9223372036854775807", "9223372036854775808", "18446744073709551615",
    "18446744073709551616", "4294967297", "1_000_000_000_000", "1" * 401, "1" * 5000,
    "0x" + "f" * 3000, "0b1", "0o7", "1e6", "50.5", "true", "false", '""', '"x"', "'1.5'", '"1e3"',
    '"\\u0000"', '"\\u001b[31m"', '"\\u0085"', '"é😀"', '"nan"', "'" + "y" * 2000 + "'",
    '"""two\nlines"""', "'../../etc'", '"SE3"', '"reduced"', '"RK4"', '"Euler"', '"sobol"',
    '"grid"', '"normal"', '"values"', '"rotation"', '"free"', '"screw"', '"from_rows"', '"rod"',
    '"universal"', '"motor"', '"drag"', "1979-05-27", "1979-05-27T07:32:00Z", "07:32:00",
    "1979-13-40", "[]", "[[]]", "[1]", "[1, 2]", "[1, 2, 3]", "[0, 0, 0]", "[1e300, 1e300, 1e300]",
    "[1, 'x', 3]", "[1, [2], 3]", "[nan, 0, 0]", "[true, false, true]", "[1, 2, 3, 4, 5, 6]",
    "[0.1, 0.2, 1.0]", "{ every = 0.1 }", "{ every = 1e-300 }", "{ from = 0, to = 1 }",
    "{ every = 1, from = nan }", "{ every = 0.1, from = 1e308, to = -1e308 }", "1e-6", "[1e-6]",
    "[[1, 0, 0], [0, 1, 0], [0, 0, 1]]", "[[1, 2], [3]]", "[1979-05-27]", "[{}]", "{}",
    "{ x = 1 }", "{ distribution = 'normal', mean = 0.0, std = 1.0 }",
    "{ distribution = 'uniform', low = 1, high = 2 }",
    "{ distribution = 'values', values = [1, 2] }",
    "{ distribution = 'normal', mean = 0, covariance = [[1, 0], [0, 1]] }",
    "{ distribution = 'rotation' }", "{ distribution = 'norml' }", "{ distribution = 3 }",
    "{ distribution = 'direction', length = { distribution = 'direction' } }",
    "{ distribution = 'values', values = [] }", "{ distribution = 'uniform', low = 2, high = 1 }",
    "{ distribution = 'uniform', low = -1e308, high = 1e308 }",
    "{ distribution = 'log_normal', median = 1e300, sigma = 1e3 }",
    "{ distribution = 'truncated_normal', mean = 0, std = 1e-320, low = nan }",
    "[" + "0, " * 3000 + "0]", "['SE3', 'SE3']", "['SE3', 'SO3xR3', 'reduced']", "= 3", "3 3",
)  # fmt: skip
KEYS = (
    "name", "mass", "inertia", "second_moments", "com", "size", "radius", "length", "density",
    "solid", "type", "rows", "axis", "slot", "pitch", "body_frame", "gravity", "forces", "omega",
    "twist", "velocities", "coordinates", "rotation", "place", "n", "seed", "method", "body",
    "joint", "initial", "dt", "t_end", "t0", "cspace", "save_every", "record", "part", "mean",
    "std", "low", "high", "values", "distribution", "stiffness", "'a.b'", '""', "'\\u0000'",
    "rtol", "atol", "dt_min", "dt_max", "max_steps", "save_at", "every", "from", "to", "events",
    "a.b.c", "sample.n", '"é"', "0", "k" * 1500,
)  # fmt: skip
HEADERS = (
    "[body]", "[[body]]", "[[sample]]", "[sample.body.mass]", "[[sample.body.mass]]", "[initial]",
    "[sample.forces.drag.linear]", "[sample.forces]", "[[problem.forces]]", "[problem.forces]",
    "[integrate.dt]", "[integrate.save_at]", "[[problem.events]]",
    "[sample.n]", "[a.b.c]", "[]", "[", "[[x]", "[sample.initial.coordinates]",
    "[" + "a." * 31 + "a]",
)  # fmt: skip

Lines = list[str]


def _values(rng: random.Random, lines: Lines) -> None:
    """The value of a key is another one."""
    number = _setting(rng, lines)
    key = lines[number].partition("=")[0]
    lines[number] = f"{key}= {rng.choice(NASTY)}"


def _keys(rng: random.Random, lines: Lines) -> None:
    """A key has another name, or a letter less."""
    number = _setting(rng, lines)
    key, _, value = lines[number].partition("=")
    name = rng.choice(KEYS) if rng.random() < 0.7 else key.strip()[:-1]
    lines[number] = f"{name} ={value}"


def _added(rng: random.Random, lines: Lines) -> None:
    lines.insert(rng.randrange(len(lines) + 1), f"{rng.choice(KEYS)} = {rng.choice(NASTY)}")


def _headers(rng: random.Random, lines: Lines) -> None:
    lines.insert(rng.randrange(len(lines) + 1), rng.choice(HEADERS))


def _deleted(rng: random.Random, lines: Lines) -> None:
    del lines[rng.randrange(len(lines))]


def _doubled(rng: random.Random, lines: Lines) -> None:
    first = rng.randrange(len(lines))
    lines[first:first] = lines[first : first + rng.randint(1, 6)]


def _shuffled(rng: random.Random, lines: Lines) -> None:
    one, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[one], lines[other] = lines[other], lines[one]


def _setting(rng: random.Random, lines: Lines) -> int:
    settings = [n for n, line in enumerate(lines) if "=" in line] or [0]
    return rng.choice(settings)


def _flipped(rng: random.Random, content: bytearray) -> None:
    for _ in range(rng.randint(1, 4)):
        content[rng.randrange(len(content))] = rng.randrange(256)


def _cut(rng: random.Random, content: bytearray) -> None:
    del content[rng.randrange(len(content)) :]


def _inserted(rng: random.Random, content: bytearray) -> None:
    what = rng.choice((b"\0", b"\r", b"\xff\xfe", b"\xef\xbb\xbf", b'"""', b"[[", b"\x1b", b"="))
    where = rng.randrange(len(content) + 1)
    content[where:where] = what


def _encoded(rng: random.Random, content: bytearray) -> None:
    text = content.decode("utf-8", "replace")
    kind = rng.choice(("utf-8-sig", "utf-16", "utf-16-le", "utf-32", "latin-1", "cp500"))
    content[:] = text.encode(kind, "replace")


def _deep(rng: random.Random, content: bytearray) -> None:
    depth = 10 ** rng.randint(1, 4)
    what = rng.choice(
        (
            "x = " + "[" * depth,
            "x = " + "[" * depth + "]" * depth,
            "x = " + "{a = " * depth,
            "[" + "a." * depth + "a]",
            "a." * depth + "a = 1",
            "x = {" + "a . " * depth + "a = 1}",
            "'a'." * depth + "a = 1",
            '"' * depth,
            "x = " + "[[[0]]], " * depth,
            "[sample.body]\nmass = " + "[" * depth + "0" + "]" * depth,
        )
    )
    content[0:0] = (what + "\n").encode()


def _large(rng: random.Random, content: bytearray) -> None:
    what = rng.choice((b"#", b"\n", b"[", b'"', b"a", b"[[a]]\n", b"0, "))
    content += what * rng.choice((10**3, 10**4, 10**5))


IN_LINES: tuple[Callable[[random.Random, Lines], None], ...] = (
    _values, _values, _values, _values, _keys, _added, _headers, _deleted, _doubled, _shuffled,
)  # fmt: skip
IN_BYTES: tuple[Callable[[random.Random, bytearray], None], ...] = (
    _flipped, _flipped, _cut, _inserted, _encoded, _deep,
)  # fmt: skip


def _bases() -> list[Lines]:
    """The shipped examples and one with every key, of few bodies each: all are made."""
    texts = [path.read_text(encoding="utf-8") for path in sorted(EXAMPLES.glob("*.toml"))]
    lines = [text.splitlines() for text in (*texts, EVERY_KEY, EVERY_KEY_OF_TIME)]
    return [["n = 2" if line.startswith("n = ") else line for line in each] for each in lines]


def hostile_file(rng: random.Random, bases: list[Lines]) -> bytes:
    """A study with a few things wrong."""
    lines = list(rng.choice(bases))
    for _ in range(rng.choice((0, 1, 1, 1, 2, 3))):
        rng.choice(IN_LINES)(rng, lines or [""])
    content = bytearray("\n".join(lines).encode())
    if rng.random() < 0.15 and content:
        rng.choice(IN_BYTES)(rng, content)
    if rng.random() < 0.002:
        _large(rng, content)
    if rng.random() < 0.0005:
        content += b"#" * LONGEST_STUDY
    return bytes(content)


def campaign(count: int, seed: int) -> Counter[str]:
    """Load so many files; what came of them.

    Raises AssertionError, with the file, for anything but a study or a StudyError with a message.
    """
    rng, bases, outcomes = random.Random(seed), _bases(), Counter[str]()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("error")
        path = Path(folder) / "hostile.toml"
        for number in range(count):
            content = hostile_file(rng, bases)
            path.write_bytes(content)
            began = time.process_time()
            try:
                outcomes[_outcome(path, number % ROUND_TRIPS == 0)] += 1
            except BaseException as error:
                what = f"{type(error).__name__}: {error}"
                raise AssertionError(f"{what}\n{_text(content)}") from error
            took = time.process_time() - began
            assert took < MOST_SECONDS, f"took {took:.0f} s\n{_text(content)}"
    added = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    assert added < MOST_MEMORY, f"{count} files from seed {seed} took {added / 2**20:.0f} MiB"
    return outcomes


def _outcome(path: Path, again: bool) -> str:
    try:
        study = Study.load(path)
    except StudyError as error:
        _check_message(error, path.name)
        return "refused"
    assert 1 <= part_size(study) <= study.output.part
    if again:
        assert_survives(study)
    return "taken"


def _check_message(error: StudyError, file: str) -> None:
    message = str(error)
    assert type(error) is StudyError
    assert message.startswith(file), message
    assert len(file) + 10 < len(message) < MOST_TOLD, message
    assert error.__context__ is None or error.__suppress_context__, message


def assert_survives(study: Study) -> None:
    """A study is itself after it was written, to TOML and to JSON."""
    read = Study.of(tomllib.loads(study.to_toml()))
    assert read == study
    assert read.digest() == study.digest()
    assert Study.model_validate(json.loads(json.dumps(study.model_dump()))) == study


def _text(content: bytes) -> str:
    return repr(content if len(content) < 20_000 else content[:20_000] + b" ...")
