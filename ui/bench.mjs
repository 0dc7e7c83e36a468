// `make page-bench`: how much later a capture is taken because of the page. Presses alternate in blocks between a rig without
// the page, with one client, with one who looks at the cameras, and with twenty clients who follow the events and read the history. It prints the
// times from a press to `captured`, and the processor time and memory of the page. It measures; it judges nothing.
import { readFileSync } from "node:fs";
import { request } from "node:http";
import { createConnection } from "node:net";
import { cpus } from "node:os";
import { Rig, until } from "./tests/rig.mjs";

const EACH = Number(process.env.PRESSES ?? 200);
const BLOCK = 20;
const MINUTES = Number(process.env.MINUTES ?? 10);
const wait = (ms) => new Promise((done) => setTimeout(done, ms));

/** A press on the socket: milliseconds until `captured`. Ends when the capture is on the disk. */
function press(rig, id) {
  return new Promise((done, fail) => {
    const socket = createConnection(rig.path("scand.sock"));
    let captured = null;
    let text = "";
    const begin = performance.now();
    socket.on("error", fail);
    socket.on("data", (bytes) => {
      text += bytes;
      for (let end = text.indexOf("\n"); end >= 0; end = text.indexOf("\n")) {
        const reply = JSON.parse(text.slice(0, end));
        text = text.slice(end + 1);
        if (reply.type === "captured") captured = performance.now() - begin;
        if (reply.type === "durable") {
          socket.end();
          done(captured);
        } else if (!["accepted", "captured"].includes(reply.type)) {
          socket.end();
          fail(new Error(JSON.stringify(reply)));
        }
      }
    });
    socket.write(`${JSON.stringify({ type: "trigger", source: "bench", press_id: id })}\n`);
  });
}

/** Asks the page; resolves to status, headers and the response, whose body nobody has read yet. */
function ask(rig, path, cookie, method = "GET", body = null) {
  const origin = `http://127.0.0.1:${rig.port}`;
  const headers = { Cookie: cookie ?? "", Origin: origin, "Content-Type": "application/json" };
  return new Promise((done, fail) => {
    request(`${origin}${path}`, { headers, method, agent: false }, done).on("error", fail).end(body);
  });
}

/** A session for each client, which outlasts the page's restarts. */
const cookies = [];

async function session(rig) {
  const token = rig.link("viewer").split("#pair=")[1];
  const answer = await ask(rig, "/api/pair", null, "POST", JSON.stringify({ token }));
  answer.resume();
  return answer.headers["set-cookie"][0].split(";")[0];
}

/** A client as a browser with the page open: it follows the events, and reads state and history now and then. */
class Client {
  async open(rig, number) {
    const cookie = (cookies[number] ??= await session(rig));
    this.stream = await ask(rig, "/api/events", cookie);
    this.stream.on("error", () => {});
    this.events = 0;
    this.stream.on("data", () => this.events++);
    this.timer = setInterval(async () => {
      for (const path of ["/api/state", "/api/recordings"]) {
        await ask(rig, path, cookie).then((answer) => answer.resume(), () => {});
      }
    }, 3000);
    return this;
  }

  close() {
    clearInterval(this.timer);
    this.stream.destroy();
  }
}

/** Processor seconds and megabytes of a process. */
function usage(pid) {
  const fields = readFileSync(`/proc/${pid}/stat`, "utf8").split(") ")[1].split(" ");
  const memory = /VmRSS:\s+(\d+)/.exec(readFileSync(`/proc/${pid}/status`, "utf8"))[1];
  return { cpu_s: (Number(fields[11]) + Number(fields[12])) / 100, memory_mb: Number(memory) / 1024 };
}

const quantile = (values, q) => [...values].sort((a, b) => a - b)[Math.min(values.length - 1, Math.floor(values.length * q))];

/** One who looks at the cameras. */
class Looker extends Client {
  async open(rig, number) {
    await super.open(rig, number);
    this.pictures = 0;
    void this.look(rig, cookies[number]);
    return this;
  }

  async look(rig, cookie) {
    for (let number = 0; !this.isClosed; ) {
      const answer = await ask(rig, `/api/look?since=${number}`, cookie).catch(() => null);
      let text = "";
      if (answer?.statusCode === 200) for await (const piece of answer) text += piece;
      if (text === "") {
        await wait(100);
        continue;
      }
      const found = JSON.parse(text);
      number = found.number;
      this.pictures += Object.values(found.cameras).filter(({ picture }) => picture).length;
    }
  }

  close() {
    this.isClosed = true;
    super.close();
  }
}

const CLIENTS = { "without the page": null, "one client": 1, "one who looks": 1, "twenty clients": 20 };

/** One block of presses; the page, if there is one, runs for this block alone. */
async function block(rig, name, number) {
  const count = CLIENTS[name];
  const clients = [];
  if (count !== null) {
    await rig.startPage();
    for (let n = 0; n < count; n++) clients.push(await new (name === "one who looks" ? Looker : Client)().open(rig, n));
    const isSeen = () => clients.every((client) => client.pictures !== 0);
    await until("the first picture", isSeen);
  }
  const pid = count === null ? null : rig.children.get("page").pid;
  const before = pid ? usage(pid) : null;
  const begin = performance.now();
  const times = [];
  for (let n = 0; n < BLOCK; n++) {
    // Presses come at any moment of what else is going on.
    await wait((n * 97) % 300);
    times.push(await press(rig, `bench-${number}-${n}`));
  }
  const seconds = (performance.now() - begin) / 1000;
  const cpu = pid ? (usage(pid).cpu_s - before.cpu_s) / seconds : null;
  const heard = clients.every((client) => client.events > 0);
  const pictures = clients[0]?.pictures;
  if (pictures !== undefined) seen.push(pictures / seconds);
  clients.forEach((client) => client.close());
  if (pid) await rig.stop("page");
  if (!heard) throw new Error("a client heard no event");
  return { times, cpu };
}

/** Pictures a second that the one who looks saw. */
const seen = [];

const rig = new Rig({ cameras: 6, size: "640x480", models: false });
try {
  await rig.startNetwork();
  await rig.startCameras();
  await rig.startDaemon();
  await rig.prepare();
  const found = new Map(Object.keys(CLIENTS).map((name) => [name, { times: [], cpus: [] }]));
  for (let round = 0, number = 0; round < EACH / BLOCK; round++) {
    for (const [name, all] of found) {
      const { times, cpu } = await block(rig, name, number++);
      all.times.push(...times);
      if (cpu !== null) all.cpus.push(cpu);
    }
  }
  console.log(`${cpus().length} processors (${cpus()[0].model}), ${EACH} presses each way in blocks of ${BLOCK}`);
  const base = quantile(found.get("without the page").times, 0.5);
  for (const [name, { times, cpus: shares }] of found) {
    const [median, p95] = [quantile(times, 0.5), quantile(times, 0.95)];
    const later = name === "without the page" ? "" : `, median ${(100 * (median / base - 1)).toFixed(1)} % later`;
    const share = shares.length ? `, the page takes ${(quantile(shares, 0.5)).toFixed(2)} of a processor` : "";
    console.log(`${name}: press to captured: median ${median.toFixed(1)} ms, p95 ${p95.toFixed(1)} ms${later}${share}`);
  }
  console.log(`the one who looks saw ${quantile(seen, 0.5).toFixed(1)} pictures a second (median of the blocks)`);
  await rig.startPage();
  const clients = [];
  for (let n = 0; n < 20; n++) clients.push(await new Client().open(rig, n));
  const pid = rig.children.get("page").pid;
  await wait(10_000);
  const [first, begin] = [usage(pid), performance.now()];
  for (let n = 0; performance.now() - begin < MINUTES * 60_000; n++) {
    await press(rig, `bench-long-${n}`);
    await wait(2000);
  }
  const last = usage(pid);
  const share = (last.cpu_s - first.cpu_s) / ((performance.now() - begin) / 1000);
  console.log(
    `twenty clients for ${MINUTES} min: memory ${first.memory_mb.toFixed(1)} MB, then ${last.memory_mb.toFixed(1)} MB; ${share.toFixed(2)} of a processor`,
  );
  clients.forEach((client) => client.close());
} finally {
  await rig.end();
}
