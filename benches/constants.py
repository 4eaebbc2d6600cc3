"""Which numeric constants of the measurements decide an answer, and of which question.

    python benches/constants.py                         # measure and experiment; many minutes
    python benches/constants.py python/stepcore/measure/tune
    python benches/constants.py --all                   # every case, not the first that changes

Each constant (as tests/test_budget.py counts them) is halved and doubled where it is assigned, in
a process of its own, and small questions (`constant_cases.py`) are asked: those that read it, found
by watching which functions run. What changes no answer is listed first, to be deleted.

An answer is its sentences and data, without what depends on the clock. The clock is a counter that
advances with each reading, so that nothing depends on how fast the machine is. Numbers of an answer
count as changed beyond 1 %; less, and rows of a trade that is not recommended, are "data". A case
that takes ten times as much processor time as before is ended, and is "slow".
"""

from __future__ import annotations

import argparse
import ast
import builtins
import contextlib
import dis
import importlib
import importlib.util
import json
import math
import os
import re
import resource
import sys
import tempfile
import time
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import Any

ROOT = Path(__file__).parents[1]
SOURCES = ROOT / "python" / "stepcore"
ROOMS = ("python/stepcore/measure", "python/stepcore/experiment")
FACTORS = (0.5, 2.0)
# What cases import besides stepcore, once before all of them.
BESIDES = ("numpy", "scipy.linalg", "scipy.optimize", "scipy.stats", "mujoco", "mujoco.rollout")
# Two clocks: an answer that they tell apart depends on time.
TICKS = (1e-4, 1.37e-4)
CLOCKS = ("monotonic", "perf_counter", "process_time", "thread_time")

sys.path.insert(0, str(ROOT / "tests"))


@dataclass(frozen=True)
class Constant:
    """A numeric constant of a module, and the node of its value."""

    module: str
    name: str
    value: Any
    line: int
    node: ast.expr

    def scaled(self, factor: float) -> Any:
        """Return the value times a factor; whole numbers stay whole and above zero."""

        def one(value: Any) -> Any:
            if isinstance(value, (tuple, list)):
                return type(value)(map(one, value))
            if isinstance(value, float):
                return value * factor
            return max(1, int(value * factor)) if value > 0 else int(value * factor)

        return one(self.value)


class Tree:
    """The modules of the package, compiled, and who holds which constant under which name."""

    def __init__(self, rooms: Sequence[str]) -> None:
        from test_budget import assignments, is_numeric

        self.files: dict[str, Path] = {}
        self.code: dict[str, CodeType] = {}
        self.trees: dict[str, ast.Module] = {}
        for file in sorted(SOURCES.rglob("*.py")):
            parts = file.relative_to(SOURCES.parent).with_suffix("").parts
            module = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            self.files[module] = file
            self.trees[module] = ast.parse(file.read_text(encoding="utf-8"))
            self.code[module] = compile(self.trees[module], str(file), "exec")
        chosen = [ROOT / room for room in rooms]
        self.constants = [
            Constant(module, target.id, ast.literal_eval(_number(value)), target.lineno, value)
            for module, tree in self.trees.items()
            if any(self.files[module].is_relative_to(room) for room in chosen)
            for target, value in assignments(tree.body)
            if isinstance(target, ast.Name) and target.id.isupper() and is_numeric(value)
        ]
        imported = {
            (module, alias.asname or alias.name): (node.module or "", alias.name)
            for module, tree in self.trees.items()
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        # Modules that hold a constant, with its name there, by (module, name) of its assignment.
        self.holders: dict[tuple[str, str], set[tuple[str, str]]] = defaultdict(set)
        known = {(constant.module, constant.name) for constant in self.constants}
        for here in (*known, *imported):
            at, passed = here, set()
            while at not in known and at in imported and at not in passed:
                passed.add(at)
                at = imported[at]
            if at in known:
                self.holders[at].add(here)

    def with_value(self, constant: Constant, factor: float) -> CodeType:
        """Return the module of a constant with another value."""
        new = ast.parse(repr(constant.scaled(factor)), mode="eval").body

        class Replacing(ast.NodeTransformer):
            def visit(self, node: ast.AST) -> ast.AST:
                return new if node is constant.node else self.generic_visit(node)

        module = constant.module
        text = self.files[module].read_text(encoding="utf-8")
        body = [Replacing().visit(node) for node in self.trees[module].body]
        tree = ast.fix_missing_locations(ast.Module(body, []))
        code = compile(tree, str(self.files[module]), "exec")
        # The tree itself is shared: it is parsed anew for the next one.
        self.trees[module] = ast.parse(text)
        return code

    def readers(self, constant: Constant, ran: dict[str, list[CodeType]]) -> bool:
        """Return whether functions that ran, by module, read a constant."""
        own = (constant.module, constant.name)
        last = constant.module.rpartition(".")[2]
        for module, codes in ran.items():
            names = [name for holder, name in self.holders[own] if holder == module]
            for code in codes:
                if any(name in code.co_names for name in names):
                    return True
                if constant.name in code.co_names and last in code.co_names:
                    return True
            if codes and any(_loads(self.code[module], name) for name in names):
                return True
        return False


def _number(node: ast.expr) -> ast.expr:
    """Return a numeric expression as a literal."""
    return ast.parse(repr(eval(ast.unparse(node), {"__builtins__": builtins})), mode="eval").body


def _loads(code: CodeType, name: str) -> bool:
    """Return whether a module reads a name while it is imported: defaults, derived constants."""
    reads = any(
        each.opname.startswith("LOAD") and each.argval == name
        for each in dis.get_instructions(code)
    )
    classes = (
        each
        for each in code.co_consts
        if isinstance(each, CodeType) and not each.co_flags & 0x02  # CO_NEWLOCALS: functions
    )
    return reads or any(_loads(each, name) for each in classes)


class Kept(SourceFileLoader):
    """Runs modules from code that is kept, one of which may have been changed."""

    code: dict[str, CodeType]

    def get_code(self, fullname: str) -> CodeType:
        return self.code[fullname]

    @classmethod
    def find_spec(cls, name: str, path: Any = None, target: Any = None) -> Any:
        file = TREE.files.get(name)
        if file is None:
            return None
        return importlib.util.spec_from_file_location(name, file, loader=cls(name, str(file)))


def begin(code: dict[str, CodeType], tick: float) -> dict[str, Callable[[], Any]]:
    """Make this process import `code`, count instead of measuring time, and return the cases."""
    Kept.code = code
    sys.meta_path.insert(0, Kept)
    counted = 0

    def clock() -> float:
        nonlocal counted
        counted += 1
        return 1.0 + tick * counted

    for name in CLOCKS:
        setattr(time, name, clock)
    warnings.simplefilter("ignore")
    from constant_cases import CASES

    return CASES


def answered(case: Callable[[], Any]) -> dict[str, Any]:
    """Return the answer of a case by the place of each of its parts."""
    try:
        result = case()
    except Exception as error:
        return _flat("answer", f"{type(error).__name__}: {error}")
    if not hasattr(result, "to_dict"):
        return _flat("answer", getattr(result, "records", result))
    found = result.to_dict()
    for name in ("generator", "ran", "motion"):
        found.pop(name, None)
    rows = found.pop("rows", [])
    chosen = [
        row for row in rows if "recommended" not in row or row["recommended"] or row["shipped"]
    ]
    return {**_flat("answer", [found, chosen]), **_flat("data", rows)}


def _flat(place: str, value: Any) -> dict[str, Any]:
    """Return plain data by place: numbers, and texts as words and numbers."""
    if isinstance(value, dict):
        parts = [(f"{place}.{name}", each) for name, each in value.items()]
    elif isinstance(value, (list, tuple)):
        parts = [(f"{place}.length", len(value))]
        parts += [(f"{place}.{k}", each) for k, each in enumerate(value)]
    elif isinstance(value, str):
        numbers = re.findall(r"\d+(?:\.\d+)?(?:e[-+]?\d+)?", value)
        words = re.sub(r"\d+(?:\.\d+)?(?:e[-+]?\d+)?", "#", value)
        return {f"{place}.words": words} | {
            f"{place}.{k}": float(number) for k, number in enumerate(numbers)
        }
    else:
        return {place: value if isinstance(value, (bool, int, float)) else str(value)}
    return {name: each for part in parts for name, each in _flat(*part).items()}


def difference(before: dict[str, Any], after: dict[str, Any], timed: set[str]) -> str:
    """Return what differs between two answers: "answer", "data" or ""."""
    found = ""
    for place in before.keys() | after.keys():
        one, other = before.get(place), after.get(place)
        if place in timed or one == other:
            continue
        close = type(one) is type(other) is float and math.isclose(one, other, rel_tol=0.01)
        if place.startswith("answer") and not close:
            return "answer"
        found = "data"
    return found


# Processes.


def children(
    jobs: Sequence[Any], work: Callable[[Any], Iterator[Any]], cores: int | None
) -> list[Any]:
    """Return what `work` yields for each job, in a process each; one that is ended yields less."""
    found: list[Any] = [None] * len(jobs)
    waiting = list(range(len(jobs)))[::-1]
    live: dict[int, tuple[int, Any]] = {}
    while waiting or live:
        while waiting and len(live) < cores:
            number = waiting.pop()
            file = tempfile.TemporaryFile("w+")  # noqa: SIM115
            child = os.fork()
            if not child:
                _work(work, jobs[number], file)
            live[child] = number, file
        child, _ = os.wait()
        number, file = live.pop(child)
        file.seek(0)
        found[number] = [json.loads(line) for line in file if line.endswith("\n")]
        file.close()
        if sys.stderr.isatty():
            done = len(jobs) - len(waiting) - len(live)
            print(f"\r{done} of {len(jobs)}", end="", file=sys.stderr, flush=True)
    return found


def _work(work: Callable[[Any], Iterator[Any]], job: Any, file: Any) -> None:
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    try:
        for each in work(job):
            file.write(json.dumps(each) + "\n")
            file.flush()
    finally:
        os._exit(0)


def ask(tick: float) -> Iterator[Any]:
    """Yield each case's answer, unchanged, and its processor time [s]."""
    for name, case in begin(TREE.code, tick).items():
        used = os.times()
        answer = answered(case)
        now = os.times()
        yield name, answer, now.user + now.system - used.user - used.system


def watch(name: str) -> Iterator[Any]:
    """Yield which constants a case reads."""
    case = begin(TREE.code, TICKS[0])[name]
    ran: dict[str, dict[CodeType, None]] = defaultdict(dict)

    def called(frame: Any, event: str, argument: Any) -> None:
        if event == "call":
            module = frame.f_globals.get("__name__", "")
            if module in TREE.files:
                ran[module][frame.f_code] = None

    sys.setprofile(called)
    answered(case)
    sys.setprofile(None)
    by_module = {module: list(codes) for module, codes in ran.items()}
    yield [k for k, each in enumerate(TREE.constants) if TREE.readers(each, by_module)]


@dataclass(frozen=True)
class Base:
    """The answers of the unchanged tree: by case, with processor times and what tells the time."""

    answers: dict[str, dict[str, Any]]
    cost: dict[str, float]
    timed: dict[str, set[str]]

    @classmethod
    def made(cls, cores: int) -> Base:
        first, second = children(TICKS, ask, cores)
        answers = {name: answer for name, answer, _ in first}
        other = {name: answer for name, answer, _ in second}
        timed = {
            name: {
                place
                for place in own.keys() | other[name].keys()
                if own.get(place) != other[name].get(place)
            }
            for name, own in answers.items()
        }
        return cls(answers, {name: cost for name, _, cost in first}, timed)

    def change(self, job: tuple[int, float, list[str], bool]) -> Iterator[Any]:
        """Yield (case, what changes) with a constant changed, until an answer does."""
        number, factor, cases, every = job
        constant = TREE.constants[number]
        known = begin({**TREE.code, constant.module: TREE.with_value(constant, factor)}, TICKS[0])
        for name in cases:
            yield name, "slow"
            spent = resource.getrusage(resource.RUSAGE_SELF)
            most = spent.ru_utime + spent.ru_stime + 5 + 10 * self.cost[name]
            resource.setrlimit(resource.RLIMIT_CPU, (int(most) + 1, resource.RLIM_INFINITY))
            what = difference(self.answers[name], answered(known[name]), self.timed[name])
            yield name, what
            if what == "answer" and not every:
                return


def told(found: list[Any]) -> dict[str, str]:
    """Return what changes by case; the last word on each case counts."""
    return {name: what for name, what in dict(found).items() if what}


def main() -> None:
    global TREE
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rooms", nargs="*", default=ROOMS, help="folders of the repository")
    parser.add_argument("--all", action="store_true", help="all cases, not the first that changes")
    parser.add_argument("--cores", type=int, default=os.cpu_count())
    options = parser.parse_args()
    for module in BESIDES:
        with contextlib.suppress(ImportError):
            importlib.import_module(module)
    TREE = Tree(options.rooms)
    base = Base.made(options.cores)
    names = sorted(base.answers, key=base.cost.__getitem__)
    failed = [(name, base.answers[name]) for name in names if "answer.words" in base.answers[name]]
    for name, answer in failed:
        print(f"not asked: {name}: {answer['answer.words']}")
    names = [name for name in names if "answer.words" not in base.answers[name]]
    read = dict(zip(names, children(names, watch, options.cores), strict=True))
    cases = [
        [name for name in names if read[name] and k in read[name][0]]
        for k in range(len(TREE.constants))
    ]
    jobs = [
        (k, factor, cases[k], options.all)
        for k in range(len(TREE.constants))
        for factor in FACTORS
        if cases[k]
    ]
    changes = dict(
        zip([job[:2] for job in jobs], children(jobs, base.change, options.cores), strict=True)
    )
    report(cases, changes)


def report(cases: list[list[str]], changes: dict[tuple[int, float], list[Any]]) -> None:
    """Print the constants: without effect, read by no case, with effect on data, on answers."""
    groups: dict[str, list[str]] = defaultdict(list)
    for k, constant in enumerate(TREE.constants):
        file = TREE.files[constant.module].relative_to(SOURCES)
        line = f"{constant.name} = {constant.value}  {file}:{constant.line}"
        effects = [told(changes.get((k, factor), [])) for factor in FACTORS]
        kinds = {what for effect in effects for what in effect.values()}
        group = next((kind for kind in ("answer", "slow", "data") if kind in kinds), "nothing")
        for word, effect in zip(("halved", "doubled"), effects, strict=True):
            if effect:
                parts = [f"{name} ({what})" for name, what in effect.items()]
                line += f"\n    {word}: {', '.join(parts)}"
        if not kinds:
            line += f"\n    read by: {', '.join(cases[k])}"
        groups[group if cases[k] else "unread"].append(line)
    titles = {
        "nothing": "change nothing, to be deleted",
        "unread": "read by no case",
        "data": "change digits or other rows only",
        "slow": "only bound the work",
        "answer": "change an answer",
    }
    for group, title in titles.items():
        print(f"\n{len(groups[group])} of {len(TREE.constants)} constants {title}:")
        print("\n".join(groups[group]))


TREE: Tree
if __name__ == "__main__":
    main()
