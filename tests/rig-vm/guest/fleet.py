"""The units of a fleet on a running system: Debian's server with the sample's users and permissions, the rig's process and a
worker, each under systemd with its key as a credential."""

import json
import re
from pathlib import Path

import scand
import service
import vivid
from harness import Chapter, Unexpected, contains, expect, run, until

SAMPLE = Path("/usr/share/doc/scand/examples/fleet-server.conf")
CONFIGURATION = Path("/etc/nats-server.conf")
SERVER, RIG, WORKER = "nats-server.service", "scand-fleet.service", "scand-worker@attic.service"
ADDRESS = "nats://127.0.0.1:4222"
STORE, OFFICE = Path("/var/lib/nats"), Path("/run/rig-vm-office.key")
KEYS = {"hall": Path("/etc/scand/fleet.key"), "attic": Path("/etc/scand-worker/attic.key"), "office": OFFICE}
OUT = Path("/run/rig-vm-archive")
parts = {}


def end():
    run("systemctl", "stop", RIG, WORKER, SERVER, timeout=300, expected=None)
    scand.clear()
    vivid.unload()
    for path in [*KEYS.values(), Path("/etc/default/scand-worker")]:
        path.unlink(missing_ok=True)
    run("apt-get", "purge", "--yes", "scand-worker", expected=None)


chapter = Chapter("fleet", end)


def host_name():
    return Path("/etc/hostname").read_text(encoding="utf-8").strip()


def server_configuration():
    """The sample for this machine alone: without a certificate, with the keys that were made here."""
    text = SAMPLE.read_text(encoding="utf-8")
    text = text.replace("0.0.0.0:4222", "127.0.0.1:4222")
    text = re.sub(r"^tls \{.*?^\}\n", "", text, flags=re.DOTALL | re.MULTILINE)
    text = text.replace("8GB", "2GB")
    for name, path in KEYS.items():
        path.parent.mkdir(exist_ok=True)
        public = run("scand", "fleet", "key", path).splitlines()[-1]
        text = text.replace(f"PUBLIC KEY OF {name}", public)
    # The rig's name is its machine's.
    return re.sub(r"(?<![A-Za-z])hall(?![A-Za-z])", host_name(), text)


def start_server():
    """As docs/fleet.md gives it: Debian's own service, with a store and our configuration."""
    run("install", "-d", "-o", "nats", "-g", "nats", "-m", "750", STORE)
    run("systemctl", "restart", SERVER)


def fleet_status():
    """What a viewer sees."""
    said = run("scand", "fleet", "status", "--fleet", ADDRESS, "--name", "office", "--credentials", OFFICE, "--json")
    # What it logs stands behind.
    return json.JSONDecoder().raw_decode(said)[0]


@chapter.step("the worker's package beside the rig's: its unit is sound, and nothing of the fleet is enabled")
def installed():
    run("apt-get", "install", "--yes", "/rig-vm/scand-worker.deb", timeout=300)
    expect(run("systemd-analyze", "verify", RIG, WORKER), "", "verify")
    scores = []
    for name in (RIG, WORKER):
        expect(scand.unit(name, "ActiveState", "UnitFileState"), ["inactive", "disabled"], name)
        judged = run("systemd-analyze", "security", "--no-pager", "--threshold=20", name)
        scores.append(judged.splitlines()[-1].split(": ")[1].split()[0])
    return f"the rig's process {scores[0]}, a worker {scores[1]}"


@chapter.step("a server with the sample's permissions; the worker's unit reaches it with its key, and listens nowhere")
def worker():
    CONFIGURATION.write_text(server_configuration(), encoding="utf-8")
    start_server()
    Path("/etc/default/scand-worker").write_text(f"SCAND_FLEET={ADDRESS}\n", encoding="utf-8")
    parts["since"] = scand.now()
    run("systemctl", "start", WORKER)
    until("the worker is connected", lambda: "connected" in scand.said(parts["since"], WORKER))
    (pid,) = scand.unit(WORKER, "MainPID")
    listening = run("ss", "--no-header", "--listening", "--tcp", "--udp", "--processes")
    if f"pid={pid}," in listening:
        raise Unexpected(f"it listens: {listening}")


@chapter.step("a press becomes a job; the rig's unit hands it to the worker, and the daemon tells its end")
def pressed():
    vivid.load([vivid.WEBCAM] * 2)
    service.configure(f'fleet = "{ADDRESS}"\n[hull]\nresolution = 24.0\n', models=1)
    scand.start()
    run("systemctl", "start", RIG)
    since = scand.now()
    contains(scand.ask("trigger"), "durable in /var/lib/scand/recordings/")
    # Two webcams that show a test pattern are no rig: the worker says why there is no model.
    told = until("the worker did it", lambda: re.search(r"capture (\S+) of \S+: its result was sent", scand.said(parts["since"], WORKER)), 900)
    until("the daemon heard of it", lambda: re.search(rf"capture {re.escape(told[1])}: .*model", scand.said(since)), 300)
    if "ermission" in scand.said(since, RIG) + scand.said(parts["since"], WORKER):
        raise Unexpected("somebody was denied something")


@chapter.step("the server loses its whole store, and the next press is done all the same")
def lost():
    run("systemctl", "stop", SERVER)
    run("find", STORE, "-mindepth", "1", "-delete")
    worker_since = scand.now()
    contains(scand.ask("trigger"), "durable")
    start_server()
    until("the worker did it", lambda: ": its result was sent" in scand.said(worker_since, WORKER), 900)


@chapter.step("an archive is made by the worker's unit, in its sandbox")
def archive():
    # The rig's name and key are in use by its unit.
    run("systemctl", "stop", RIG, "scand.service")
    words = ["--fleet", ADDRESS, "--name", host_name(), "--credentials", KEYS["hall"], "--set", "hull.resolution=24"]
    run("scand", "--replay", "/rig-vm/rig.mcap", "--out", OUT, *words, expected=None, timeout=2400)
    models = list(OUT.rglob("model.glb"))
    if not models:
        raise Unexpected(f"no model: {scand.said(parts['since'], WORKER)[-600:]}")
    expect(models[0].read_bytes()[:4], b"glTF", "the model")
    expect([worker["worker"] for worker in fleet_status()["workers"]], ["attic"], "the workers that a viewer sees")
    return f"a model of {models[0].parent.name}"


@chapter.step("no key is in the journal or the recordings; stopped, the worker ends well")
def ended():
    journal = run("journalctl", "-b", "--no-pager", "-o", "cat", expected=None)
    held = [path.read_bytes() for path in scand.RECORDINGS.rglob("*") if path.is_file()]
    for path in KEYS.values():
        seed = path.read_text(encoding="utf-8").strip()
        if seed in journal or any(seed.encode() in bytes_ for bytes_ in held):
            raise Unexpected(f"the key {path.name} was written somewhere")
    run("systemctl", "stop", WORKER, timeout=300)
    expect(scand.unit(WORKER, "Result"), ["success"], "the worker's end")
