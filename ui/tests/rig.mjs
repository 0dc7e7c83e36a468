// A whole rig for the page's tests and its demonstration: simulated cameras that play a recording, the daemon, and the
// page, each a process of its own; cameras and daemon in a network of their own. Nothing of it survives `end`.
import { spawn, spawnSync } from "node:child_process";
import { once } from "node:events";
import { createWriteStream, mkdirSync, mkdtempSync, readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { createServer } from "node:net";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";

const ROOT = resolve(new URL("../..", import.meta.url).pathname);
export const SCAND = resolve(ROOT, process.env.SCAND ?? "target/debug/scand");

/** Width and height of the depth camera's frames, and how much of each has a reading, in percent. */
const DEPTH_SIZE = [160, 120];
export const READINGS_PERCENT = 75;

/** Milliseconds from which on pictures that were not taken together make a model amber and red: on a busy machine the simulated
 * cameras are late, and that is no matter here. */
export const USUAL_SKEW = [4000, 10000];

const wait = (ms) => new Promise((done) => setTimeout(done, ms));

/** Waits until something is true. */
export async function until(what, is, seconds = 60) {
  for (let n = 0; n < seconds * 10; n++) {
    if (await is()) return;
    await wait(100);
  }
  throw new Error(`${what}: not within ${seconds} s`);
}

async function freePort() {
  const server = createServer().listen(0, "127.0.0.1");
  await once(server, "listening");
  const { port } = server.address();
  server.close();
  await once(server, "close");
  return port;
}

export class Rig {
  constructor(options) {
    this.options = { cameras: 6, size: "320x240", shape: "mug", resolution: 80, skew: USUAL_SKEW, platesLimit: 24, ...options };
    this.folder = options?.folder ?? mkdtempSync(join(tmpdir(), "scand-page-"));
    mkdirSync(this.folder, { recursive: true });
    this.children = new Map();
    /** What ended although nobody stopped it, and how. */
    this.fallen = [];
  }

  path(name) {
    return join(this.folder, name);
  }

  /** What a command says, or an error with it. */
  scand(...args) {
    const found = spawnSync(SCAND, args, { cwd: this.folder, encoding: "utf8" });
    if (found.status !== 0) throw new Error(`scand ${args.join(" ")}: ${found.error ?? ""} ${found.stderr} ${found.stdout}`);
    return found.stdout;
  }

  log(name) {
    try {
      return readFileSync(this.path(`${name}.log`), "utf8");
    } catch {
      return "";
    }
  }

  /** How long each process's log is, by its name. */
  logLengths() {
    const names = readdirSync(this.folder).filter((name) => name.endsWith(".log"));
    return new Map(names.map((name) => [name.slice(0, -4), this.log(name.slice(0, -4)).length]));
  }

  /** The last lines of every process's log, after so many characters of each. */
  lastWords(since = new Map(), most = 80) {
    const words = [...this.logLengths().keys()].map((name) => {
      const lines = this.log(name).slice(since.get(name) ?? 0).trimEnd().split("\n");
      return `--- ${name}.log\n${lines.slice(-most).join("\n")}`;
    });
    return words.join("\n");
  }

  run(name, command, args, environment = {}) {
    const env = { ...process.env, ...environment };
    const child = spawn(command, args, { cwd: this.folder, env, stdio: ["pipe", "pipe", "pipe"] });
    const log = createWriteStream(this.path(`${name}.log`), { flags: "a" });
    child.stdout.pipe(log, { end: false });
    child.stderr.pipe(log, { end: false });
    child.on("error", (error) => log.write(`${error}\n`));
    child.on("exit", (code, signal) => {
      const how = signal ? `killed by ${signal}` : `exit code ${code}`;
      log.write(`rig.mjs: ${name} has ended: ${how}\n`);
      // Who stops a process takes it off the list first.
      if (this.children.get(name) === child) this.fallen.push(`${name}: ${how}`);
    });
    this.children.set(name, child);
    return child;
  }

  /** Runs a command in the rig's network. */
  inside(name, command, args, environment) {
    const pid = String(this.children.get("network").pid);
    return this.run(name, "nsenter", ["-t", pid, "-U", "--preserve-credentials", "-n", "--", command, ...args], environment);
  }

  async stop(name, signal = "SIGTERM") {
    const child = this.children.get(name);
    if (!child) return;
    this.children.delete(name);
    if (child.exitCode !== null || child.signalCode !== null) return;
    const ended = once(child, "exit");
    child.kill(signal);
    await Promise.race([ended, wait(15000).then(() => child.kill("SIGKILL"))]);
  }

  async start() {
    await this.startNetwork();
    await this.startCameras();
    await this.startDaemon();
    await this.startPage();
  }

  async startNetwork() {
    const { cameras } = this.options;
    const addresses = Array.from({ length: cameras }, (_, n) => `ip address add 127.0.1.${n + 1}/8 dev lo`);
    const script = ["ip link set lo up", ...addresses, "echo up", "exec sleep infinity"].join("\n");
    this.run("network", "unshare", ["--user", "--map-root-user", "--net", "sh", "-c", script]);
    await until("the rig's network", () => this.log("network").includes("up"));
  }

  async startCameras() {
    const { cameras, size, shape } = this.options;
    const render = ["--cameras", String(cameras), "--size", size, "--depth-cameras", "0", "--textured"];
    this.scand("simulate", "--shape", shape, ...render, "--out", "served.mcap");
    this.scand("info", "served.mcap", "--calibration", "calibration.toml");
    this.inside("cameras", SCAND, ["simulate", "--serve", "served.mcap", "--empty"]);
    await until("the cameras", () => this.log("cameras").includes("serving"));
  }

  /** Starts the cameras again after they were stopped. */
  async startCamerasAgain() {
    this.inside("cameras", SCAND, ["simulate", "--serve", "served.mcap"]);
    await wait(300);
  }

  /** What the daemon says of itself. */
  status() {
    return JSON.parse(this.scand("status", "--socket", "scand.sock", "--json")).status;
  }

  /** Puts the object into the rig, or takes it out. */
  async show(what) {
    await this.tell(what);
  }

  /** Says something to the simulated cameras (`scand simulate --serve`). */
  async tell(words) {
    this.children.get("cameras").stdin.write(`${words}\n`);
    await wait(300);
  }

  /** What the daemon needs around it so that it finds a depth camera: a test sensor of OpenNI2 that plays one frame. */
  depthCamera() {
    const staged = spawnSync(join(ROOT, "tests/openni2-sensor/stage.sh"), { encoding: "utf8" });
    if (staged.status !== 0) throw new Error(`the test sensor: ${staged.error ?? ""} ${staged.stderr}`);
    const frames = this.path("frames");
    // tests/openni2-sensor/src/frames.rs has the format: one capture of one depth frame and one colour frame.
    const head = Buffer.alloc(68);
    head.write("SCANDDP1kinect", "latin1");
    [...DEPTH_SIZE, 30, 100, 1, 1, 1].forEach((number, place) => head.writeUInt32LE(number, 40 + 4 * place));
    const pixels = DEPTH_SIZE[0] * DEPTH_SIZE[1];
    const first = (pixels * (100 - READINGS_PERCENT)) / 100;
    const readings_mm = Uint16Array.from({ length: pixels }, (_, pixel) => (pixel < first ? 0 : 800 + (pixel % 100)));
    writeFileSync(frames, Buffer.concat([head, Buffer.from(readings_mm.buffer), Buffer.alloc(3 * pixels, 128)]));
    return { LD_LIBRARY_PATH: staged.stdout.trim(), SCAND_OPENNI2_FRAMES: frames };
  }

  /** Writes the cameras' calibration and that of a depth camera, which looks straight down from 0.85 m. */
  writeDepthCalibration() {
    const [width, height] = DEPTH_SIZE;
    const kinect = `[cameras.kinect]
size = [${width}, ${height}]
focal_px = [144.0, 144.0]
center_px = [${((width - 1) / 2).toFixed(1)}, ${((height - 1) / 2).toFixed(1)}]
distortion_model = ""
distortion = []
translation = [0.0, 0.0, 0.85]
rotation = [1.0, 0.0, 0.0, 0.0]
[cameras.kinect.response]
slope = 0.001
intercept = 0.0
scale = [1.0, 0.0, 0.0, 0.0, 0.0]
uncertainty = 0.0
`;
    writeFileSync(this.path("calibration-depth.toml"), `${readFileSync(this.path("calibration.toml"), "utf8")}\n${kinect}`);
  }

  /** Has background pictures and the object in the rig, as after the first captures, whichever test ran before. */
  async prepare() {
    if (this.isPrepared) return;
    this.isPrepared = true;
    this.scand("background", "--socket", "scand.sock");
    await this.show("captures");
  }

  writeConfiguration() {
    const { cameras, resolution, depth } = this.options;
    const ids = Array.from({ length: cameras }, (_, n) => `c${String(n).padStart(2, "0")}`);
    const sections = ids.map((id, n) => `[aravis.cameras.${id}]\naddress = "127.0.1.${n + 1}"`);
    if (depth) sections.push(`[openni2.cameras.kinect]\nsize = [${DEPTH_SIZE.join(", ")}]\nrate = 30`);
    writeFileSync(
      this.path("rig.toml"),
      `[rig]
name = "loopback"
calibration = "calibration${depth ? "-depth" : ""}.toml"
[sync]
window_ms = 3000.0
go_on_without_missing = ${this.options.goOn === true}
[capture]
largest_skew_ms = ${(this.options.largestSkew ?? USUAL_SKEW[0]).toFixed(6)}
patience_ms = 2000
retry = 0
[recording]
folder = "recordings"
keep_free_mb = ${this.options.keepFree ?? 200}
[hull]
resolution = ${resolution}.0
[workers]
folder = "models"
memory_mb = 2000
count = ${this.options.models === false ? 0 : 1}
nice = 0
[socket]
path = "scand.sock"
[verdict]
hull_is_wanted = true
[verdict.skew_ms]
amber = ${this.options.skew[0]}
red = ${this.options.skew[1]}
[verdict.background_age_h]
amber = ${this.options.platesLimit}.0
[service]
missing_cameras = ${cameras}
patience_s = 1.0
[aravis.defaults]
trigger = "software"
transfer = "srgb"
packet_size = 9000
${sections.join("\n")}
`,
    );
  }

  async startDaemon() {
    if (this.options.depth) this.writeDepthCalibration();
    this.writeConfiguration();
    const environment = this.options.depth ? this.depthCamera() : {};
    this.inside("daemon", SCAND, ["run", "--config", "rig.toml"], environment);
    await until("the daemon", () => {
      const found = spawnSync(SCAND, ["status", "--socket", "scand.sock", "--json"], { cwd: this.folder, encoding: "utf8" });
      if (found.status !== 0) return false;
      const { status } = JSON.parse(found.stdout);
      const states = Object.values(status.cameras).map((camera) => camera.state);
      return states.length > 0 && states.every((state) => state === "ready");
    });
  }

  async startPage() {
    this.port ??= this.options.port ?? (await freePort());
    // A second way to the page, which a test can cut.
    this.wire ??= new Wire(this.port);
    this.wirePort ??= await this.wire.listen();
    const origins = [this.port, this.wirePort].map((port) => `"http://127.0.0.1:${port}"`);
    writeFileSync(
      this.path("page.toml"),
      `listen = "127.0.0.1:${this.port}"
origins = [${origins.join(", ")}]
rig = "Demonstration"
socket = "scand.sock"
models = "models"
recordings = "recordings"
state = "page-state"
cache = "page-cache"
control = "control.sock"
`,
    );
    // The log has those of earlier starts too.
    const starts = () => this.log("page").split("the page is at").length;
    const before = starts();
    this.run("page", SCAND, ["page", "--config", "page.toml"]);
    await until("the page", () => starts() > before);
  }

  /** A second page beside the first, which is reached over TLS alone; its origin. */
  async startPageWithTls() {
    const port = await freePort();
    for (const name of ["page-certificate.pem", "page-key.pem"]) {
      const text = readFileSync(join(ROOT, "tests/support", name));
      writeFileSync(this.path(name), text, { mode: 0o600 });
    }
    const origin = `https://localhost:${port}`;
    writeFileSync(
      this.path("page-tls.toml"),
      `listen = "0.0.0.0:${port}"
origins = ["${origin}"]
tls = { certificate = "page-certificate.pem", key = "page-key.pem" }
socket = "scand.sock"
models = "models"
recordings = "recordings"
state = "page-tls-state"
cache = "page-tls-cache"
control = "control-tls.sock"
`,
    );
    this.run("page-tls", SCAND, ["page", "--config", "page-tls.toml"]);
    await until("the page with TLS", () => this.log("page-tls").includes("the page is at"));
    return origin;
  }

  /** The token that begins a session, as a link has it. */
  token(role, config = "page.toml") {
    const said = this.scand("page", "pair", "--role", role, "--config", config);
    return /#pair=[0-9a-f]{64}/.exec(said)[0];
  }

  /** The link that begins a session. */
  link(role = "operator", port = this.port) {
    return `http://127.0.0.1:${port}/${this.token(role)}`;
  }

  async end() {
    for (const name of ["page", "page-tls", "daemon", "cameras", "network"]) await this.stop(name);
    this.wire?.close();
    if (!this.options.keep) rmSync(this.folder, { recursive: true, force: true });
  }
}

/** A wire between a browser and the page, which can be cut: then nothing passes, and nobody is told. */
class Wire {
  constructor(port) {
    this.port = port;
    this.pairs = new Set();
    this.isCut = false;
  }

  async listen() {
    const { createConnection } = await import("node:net");
    this.server = createServer((near) => {
      const far = createConnection(this.port, "127.0.0.1");
      const pair = [near, far];
      this.pairs.add(pair);
      const pass = (from, to) => {
        from.on("data", (bytes) => this.isCut || to.write(bytes));
        from.on("close", () => {
          this.pairs.delete(pair);
          to.destroy();
        });
        from.on("error", () => {});
      };
      pass(near, far);
      pass(far, near);
    }).listen(0, "127.0.0.1");
    await once(this.server, "listening");
    return this.server.address().port;
  }

  /** Silence both ways. */
  cut() {
    this.isCut = true;
  }

  /** What was cut is closed; what comes anew passes. */
  mend() {
    for (const pair of this.pairs) pair.forEach((socket) => socket.destroy());
    this.isCut = false;
  }

  close() {
    this.mend();
    this.server?.close();
  }
}
