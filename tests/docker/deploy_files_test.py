#!/usr/bin/env python3
"""The files of docker/ say what the server says: metrics, options, ports. Standard library only.

Usage: deploy_files_test.py [BRICKYARD]    With the command, its own /metrics and --help are what counts.
What nginx, promtool and systemd-analyze can check is checked where they are installed.
"""
import glob
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
METRIC = re.compile(r"\b(?:brickyard|process)_[a-z_]+\b")
wrong = []


def expect(holds, message):
    if not holds:
        wrong.append(message)


def read(path):
    with open(os.path.join(ROOT, path), encoding="utf-8") as file:
        return file.read()


def documented():
    """Name to type, from the table of docs/deploy.md."""
    row = r"^\| `((?:brickyard|process)_[a-z_]+)[^|]*\| (counter|gauge|histogram) \|"
    return dict(re.findall(row, read("docs/deploy.md"), re.M))


def family(name, types):
    """`a_seconds_bucket` is of the histogram `a_seconds`."""
    base = re.sub(r"_(bucket|sum|count)$", "", name)
    return base if types.get(base) == "histogram" else name


def withoutComments(text):
    return re.sub(r"^\s*#.*$", "", text, flags=re.M)


def checkDashboard(types):
    board = json.loads(read("docker/grafana/dashboards/brickyard.json"))
    used, ids = set(), []
    for panel in board["panels"]:
        ids.append(panel["id"])
        expect(panel["targets"], f"dashboard: panel {panel['title']!r} shows nothing")
        for target in panel["targets"]:
            names = set(METRIC.findall(target["expr"]))
            expect(names or re.search(r"\bup\b", target["expr"]), f"dashboard: {target['expr']}: no metric of ours")
            used |= {family(name, types) for name in names}
    expect(len(ids) == len(set(ids)), "dashboard: two panels of one id")
    boxes = [panel["gridPos"] for panel in board["panels"]]
    for i, a in enumerate(boxes):
        expect(a["x"] + a["w"] <= 24, f"dashboard: panel {ids[i]} reaches beyond the right edge")
        for b in boxes[:i]:
            beside = a["x"] + a["w"] <= b["x"] or b["x"] + b["w"] <= a["x"]
            expect(beside or a["y"] + a["h"] <= b["y"] or b["y"] + b["h"] <= a["y"], f"dashboard: panel {ids[i]} lies on another")
    return used


def checkRates(text, types, where):
    """rate() of a gauge, and a counter without it, draw nonsense."""
    for name in METRIC.findall(text):
        kind = types.get(family(name, types))
        rated = re.search(rf"\brate\({name}\b", text) is not None
        if kind == "gauge":
            expect(not rated, f"{where}: rate() of the gauge {name}")
        elif kind:
            expect(rated, f"{where}: {name} is a {kind}: take its rate()")


def checkMetrics(types, source):
    alerts = withoutComments(read("docker/prometheus/alerts.yml"))
    # Names in a text for a person count as well: it sends him to look at them.
    names = {family(name, types) for name in METRIC.findall(alerts)}
    for name in sorted(checkDashboard(types) | names):
        expect(name in types, f"{name}: {source} has no such metric")
    for expression in re.findall(r"expr: (?:>-\n\s+)?(.+)", alerts):
        checkRates(expression, types, "alerts.yml")
    for panel in json.loads(read("docker/grafana/dashboards/brickyard.json"))["panels"]:
        for target in panel["targets"]:
            checkRates(target["expr"], types, "dashboard")


def serveOptions():
    """Every option that some file gives to `brickyard serve`, with where it stands."""
    found = {}
    texts = {
        "docker/server.Dockerfile": "\n".join(re.findall(r"^(?:CMD|ENTRYPOINT) .*", read("docker/server.Dockerfile"), re.M)),
        "docker/compose.yaml": "\n".join(re.findall(r"^    - (--\S+)$", read("docker/compose.yaml"), re.M)),
    }
    for path in glob.glob(os.path.join(ROOT, "docker", "systemd", "*")):
        name = os.path.relpath(path, ROOT)
        texts[name] = "\n".join(re.findall(r"^(?:ExecStart|\s+--|.*BRICKYARD_OPTIONS=).*", read(name), re.M))
    manifest = re.search(r"```yaml\n(.*?)```", read("docs/deploy.md"), re.S)
    texts["docs/deploy.md"] = "\n".join(re.findall(r"args: .*|^\s+- --.*", manifest.group(1), re.M)) if manifest else ""
    expect(manifest, "docs/deploy.md: the manifest is gone")
    for where, text in texts.items():
        for option in re.findall(r"(?<![\w-])--[a-z-]+", text):
            found.setdefault(option, where)
    expect("--listen" in found and "--token-file" in found, "the options of the server were not found in docker/")
    return found


def checkServer(command):
    """Gives the server's metrics, name to type; None from a server that has none."""
    help_text = subprocess.run([command, "serve", "--help"], capture_output=True, text=True).stdout
    if "--rescan" not in help_text:
        print("skipped: this server is older than docker/: its options and metrics")
        return None
    for option, where in sorted(serveOptions().items()):
        expect(re.search(rf"{option}\b(?!-)", help_text), f"{where}: brickyard serve has no {option}")
    with tempfile.TemporaryDirectory() as folder:
        return runningMetrics(command, folder)


def runningMetrics(command, folder):
    said = os.path.join(folder, "said")
    os.mkdir(os.path.join(folder, "data"))
    # A build without OpenVDB serves the empty folder, as a new machine does.
    subprocess.run([command, "convert", os.path.join(ROOT, "tests", "data", "plume", "plume.0030.vdb"),
                    os.path.join(folder, "data", "plume.bricks")], capture_output=True)
    with open(said, "w") as out:
        server = subprocess.Popen([command, "serve", os.path.join(folder, "data"), "--listen", "127.0.0.1:0"], stdout=out,
                                  stderr=out, stdin=subprocess.DEVNULL)
    try:
        port = None
        for _ in range(300):
            with open(said) as file:
                match = re.search(r"127\.0\.0\.1:(\d+)", file.read())
            if match or server.poll() is not None:
                port = match and match.group(1)
                break
            time.sleep(0.1)
        if not port:
            with open(said) as file:
                expect(False, f"brickyard serve does not listen: {file.read().strip()}")
            return None
        for path in ("healthz", "metrics"):  # something is counted once there was something
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/{path}", timeout=30) as reply:
                text = reply.read().decode()
        return dict(re.findall(r"^# TYPE (\S+) (\S+)$", text, re.M))
    except urllib.error.URLError as error:
        expect(False, f"/metrics: {error}")
        return None
    finally:
        server.send_signal(signal.SIGTERM)
        try:
            status = server.wait(60)
            expect(status == 0, f"brickyard serve: exit status {status} after SIGTERM")
        except subprocess.TimeoutExpired:
            server.kill()
            server.wait()
            expect(False, "brickyard serve does not end after SIGTERM")


def checkFiles():
    """What stands twice, stands the same."""
    dockerfile, compose = read("docker/server.Dockerfile"), read("docker/compose.yaml")
    for name in ("docker/server.Dockerfile", "docker/converter.Dockerfile"):
        text = read(name)
        expect(re.search(r"^USER 1", text, re.M), f"{name}: runs as root")
        expect(os.path.exists(os.path.join(ROOT, name + ".dockerignore")), f"{name}.dockerignore is missing")
        for source in re.findall(r"^COPY (?!--from)(\S+) ", text, re.M):
            expect(source == "." or os.path.exists(os.path.join(ROOT, source)), f"{name}: there is no {source}")
        preset = re.search(r"tools/build (\w+)", text).group(1)
        presets = [each["name"] for each in json.loads(read("CMakePresets.json"))["configurePresets"]]
        expect(preset in presets, f"{name}: CMakePresets.json has no {preset}")
        for kept in re.findall(r"^!(\S+)$", read(name + ".dockerignore"), re.M):
            expect(os.path.exists(os.path.join(ROOT, kept)), f"{name}.dockerignore: there is no {kept}")
    expect("openvdb" not in withoutComments(dockerfile).lower(), "docker/server.Dockerfile: the server needs no OpenVDB")
    port = re.search(r"^EXPOSE (\d+)$", dockerfile, re.M).group(1)
    for name in ("docker/compose.yaml", "docker/nginx/nginx.conf", "docker/prometheus/prometheus.yml"):
        ports = set(re.findall(r"(?:server-\d|0\.0\.0\.0):(\d+)", read(name)))
        expect(ports == {port}, f"{name}: the server's port is {port}, not {sorted(ports)}")
    services = set(re.findall(r"^  (server-\d+):", compose, re.M))
    for name in ("docker/nginx/nginx.conf", "docker/prometheus/prometheus.yml"):
        expect(set(re.findall(r"server-\d+", read(name))) == services, f"{name}: the servers are {sorted(services)}")
    # A mounted file that is not there becomes an empty folder.
    for source in re.findall(r"^      - (\./[^:]+):", compose, re.M):
        expect(os.path.exists(os.path.join(ROOT, "docker", source)), f"docker/compose.yaml: there is no {source}")
    variables = set(re.findall(r"\$\{(\w+):-", compose))
    example = set(re.findall(r"^(\w+)=", read("docker/.env.example"), re.M))
    expect(variables == example, f"docker/.env.example: differs from compose.yaml in {sorted(variables ^ example)}")
    for path in glob.glob(os.path.join(ROOT, "docker", "**", "*.y*ml"), recursive=True):
        with open(path, encoding="utf-8") as file:
            expect("\t" not in file.read(), f"{path}: a tab; YAML indents with spaces")


def runTool(arguments, what):
    run = subprocess.run(arguments, capture_output=True, text=True)
    expect(run.returncode == 0, f"{what}: {(run.stderr or run.stdout).strip()}")


def tool(name, packages):
    path = shutil.which(name, path=os.environ.get("PATH", "") + ":/usr/sbin:/sbin")
    if not path:
        print(f"skipped: {name} is not installed (Debian: {packages})")
    return path


def checkWithTools(command):
    with tempfile.TemporaryDirectory() as folder:
        nginx, openssl = tool("nginx", "nginx-light"), tool("openssl", "openssl")
        if nginx and openssl:
            subprocess.run([openssl, "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost",
                            "-keyout", folder + "/privkey.pem", "-out", folder + "/fullchain.pem"],
                           capture_output=True, check=True)
            text = read("docker/nginx/nginx.conf")
            for old, new in (("/etc/nginx/tls", folder), ("/var/cache/nginx", folder), ("/run/nginx.pid", folder + "/pid"),
                             ("/dev/stdout", folder + "/access"), ("/dev/stderr", folder + "/error"),
                             # Names that only the network of compose knows.
                             ("server-1:", "127.0.0.1:"), ("server-2:", "127.0.0.1:")):
                expect(old in text, f"docker/nginx/nginx.conf: {old} is gone")
                text = text.replace(old, new)
            with open(folder + "/nginx.conf", "w") as file:
                file.write(text)
            runTool([nginx, "-t", "-p", folder, "-e", folder + "/first_error", "-c", folder + "/nginx.conf"],
                    "docker/nginx/nginx.conf")
        if promtool := tool("promtool", "prometheus"):
            runTool([promtool, "check", "rules", ROOT + "/docker/prometheus/alerts.yml"], "alerts.yml")
            text = read("docker/prometheus/prometheus.yml").replace("/run/secrets/metrics_token", folder + "/token")
            for name, content in (("token", "sesame\n"), ("prometheus.yml", text),
                                  ("alerts.yml", read("docker/prometheus/alerts.yml"))):
                with open(os.path.join(folder, name), "w") as file:
                    file.write(content)
            runTool([promtool, "check", "config", folder + "/prometheus.yml"], "prometheus.yml")
        if analyze := tool("systemd-analyze", "systemd"):
            text = read("docker/systemd/brickyard.service").replace("/usr/local/bin/brickyard", command or "/bin/true")
            with open(folder + "/brickyard.service", "w") as file:
                file.write(text)
            # Words that it does not know are warnings, and the exit status stays 0.
            run = subprocess.run([analyze, "verify", folder + "/brickyard.service"], capture_output=True, text=True)
            for line in run.stderr.splitlines():
                if "brickyard.service:" in line:
                    expect(False, line.replace(folder, "docker/systemd"))


def main():
    command = os.path.abspath(sys.argv[1]) if len(sys.argv) > 1 else None
    if command and not os.access(command, os.X_OK):
        print(f"{command}: not built; run tools/build release brickyard")
        return 1
    types = documented()
    expect(types, "docs/deploy.md: the table of metrics is gone")
    checkFiles()
    checkMetrics(types, "docs/deploy.md")
    real = checkServer(command) if command else None
    if real:
        checkMetrics(real, "/metrics")
        for name in sorted(set(types) ^ set(real)):
            expect(False, f"{name}: {'/metrics' if name in types else 'docs/deploy.md'} lacks it")
        for name in sorted(set(types) & set(real)):
            expect(types[name] == real[name], f"{name}: a {real[name]}, not a {types[name]} as docs/deploy.md says")
    checkWithTools(command)
    for line in wrong:
        print(line)
    return 1 if wrong else 0


sys.exit(main())
