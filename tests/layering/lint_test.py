#!/usr/bin/env python3
"""tools/lint finds each of these, at its line, and nothing in what is allowed."""
import os
import re
import subprocess
import sys
import tempfile

LINT = os.path.join(os.path.dirname(os.path.realpath(__file__)), "..", "..", "tools", "lint")

# Each line stands in a coroutine of its own; the second value says whether lint must object.
LINES = [
    ("co_await send(Message{1, name});", True),
    ("co_await send({1, name});", True),
    ("co_await send(Message{.name = name});", True),
    ("co_await send([name] { return name; });", True),
    ("const auto v = co_await read(fast ? a : b);", True),
    ("const std::array both{co_await read(a), co_await read(b)};", True),
    ("store(Message{1}, co_await read(a));", True),
    ("co_await send(std::move(message));", False),
    ("co_await send([] { return 1; });", False),
    ("co_await send(names[3], size);", False),
    ("co_await (read(a) || wait(deadline));", False),
    ("const int n = co_await read(fast ? 1 : 2);  // lint: trivial", False),
    ("// co_await send({1, name});", False),
    ('log("co_await send({1})");', False),
    ("while (!co_await read(a)) { const Message message{1}; }", False),
    ("if (n > 1'000) { co_await wait(1'000); }", False),
    ("spawn([this]() -> Task { co_await read(a); });", False),
]


def lint(text, name):
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, name)
        with open(path, "w", encoding="utf-8") as file:
            file.write(text)
        run = subprocess.run([sys.executable, LINT, path], capture_output=True, text=True)
    return {int(line) for line in re.findall(r":(\d+): (?!not formatted)", run.stdout)}


def lintAll(texts):
    """Files and lines of the types that another file of the same program defines as well."""
    with tempfile.TemporaryDirectory() as folder:
        paths = []
        for name, text in texts.items():
            paths.append(os.path.join(folder, name))
            with open(paths[-1], "w", encoding="utf-8") as file:
                file.write(text)
        run = subprocess.run([sys.executable, LINT, *paths], capture_output=True, text=True)
    return {(os.path.basename(file), int(line))
            for file, line in re.findall(r"^(.+?):(\d+): \w+ is a type in", run.stdout, re.M)}


def main():
    wrong = []
    text = "".join(f"Task f{i}() {{ {line} \n}}\n" for i, (line, _) in enumerate(LINES))
    found = lint(text, "coroutines.cpp")
    for i, (line, bad) in enumerate(LINES):
        if (2 * i + 1 in found) != bad:
            wrong.append(f"{'not found' if bad else 'found wrongly'}: {line}")
    if lint('#include "../core/result.h"\n', "a.cpp") != {1}:
        wrong.append('an include through "../" was not found')
    if lint("int a();\n", "a.h") != {1}:
        wrong.append("a header without #pragma once was not found")
    twins = {
        "a.h": "#pragma once\nnamespace brickyard {\nstruct One {\n    int a;\n};\nclass Two {};\n}  // namespace brickyard\n",
        "b.cpp": "namespace brickyard {\nnamespace {\nstruct One {};\n}  // namespace\nstruct Two::One {};\n}\n",
        "c.cpp": "namespace brickyard {\nstruct One : Two {\n};\n}  // namespace brickyard\n",
    }
    if lintAll(twins) != {("c.cpp", 2)}:
        wrong.append(f"of two types of one name {lintAll(twins)} was found")
    for line in wrong:
        print(line)
    return 1 if wrong else 0


sys.exit(main())
