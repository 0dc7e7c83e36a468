// `make page-demo`: the simulated rig, the daemon and the page on this machine, until Ctrl-C. What it makes lies in
// out/page-demo, and is removed at the end. With PICTURES=FOLDER it takes the documentation's pictures instead, and ends.
import { Rig } from "./tests/rig.mjs";
import { resolve } from "node:path";

const folder = resolve(new URL("../out/page-demo", import.meta.url).pathname);
const rig = new Rig({ folder, cameras: 11, size: "640x480", shape: "mug", resolution: 160, port: Number(process.env.PORT ?? 8437) });
const stop = async () => {
  await rig.end();
  process.exit(0);
};
process.on("SIGINT", stop);
process.on("SIGTERM", stop);
try {
  await rig.start();
  rig.scand("background", "--socket", "scand.sock");
  await rig.show("captures");
  if (process.env.PICTURES) {
    const { takePictures } = await import("./pictures.mjs");
    await takePictures(rig, resolve(process.env.PICTURES));
    await stop();
  }
  console.log(`Open this link in a browser on this machine; it begins an operator's session, once:\n\n  ${rig.link()}\n`);
  console.log("Press there: the simulated rig has a mug in it, and its model is made in some seconds. Ctrl-C ends all.");
} catch (error) {
  console.error(error);
  await rig.end();
  process.exit(1);
}
