"""The kernel's own test cameras (vivid): webcams, and capture cards whose cable we feed, so that every byte is known."""

import random
import subprocess
from pathlib import Path

from harness import Unexpected, run, until

WEBCAM, CABLE = "webcam", "cable"
DRIVER = Path("/sys/bus/platform/drivers/vivid")
# Stable names, which every vivid camera needs: all of them hang on one bus, so that the kernel counts them through.
RULE = 'SUBSYSTEM=="video4linux", ATTR{name}=="vivid-*-vid-*", SYMLINK+="rig/$attr{name}"\n'
BYTES = {"RGGB": 1, "GRBG": 1, "GREY": 1, "YUYV": 2, "UYVY": 2, "RGB3": 3, "BGR3": 3}
PIXELS = {
    "RGGB": "bayer_rggb8",
    "GRBG": "bayer_grbg8",
    "GREY": "mono8",
    "YUYV": "yuyv",
    "UYVY": "uyvy",
    "RGB3": "rgb8",
    "BGR3": "bgr8",
}


def capture(index):
    """The path of a camera."""
    return Path(f"/dev/rig/vivid-{index:03d}-vid-cap")


def output(index):
    """The path of what feeds a camera."""
    return Path(f"/dev/rig/vivid-{index:03d}-vid-out")


def load(kinds):
    """Plugs cameras of these kinds in."""
    rule = Path("/run/udev/rules.d/60-rig-vm-video.rules")
    rule.parent.mkdir(parents=True, exist_ok=True)
    rule.write_text(RULE, encoding="ascii")
    run("udevadm", "control", "--reload")
    lists = {
        "node_types": ["0x101" if kind == CABLE else "0x1" for kind in kinds],
        "num_inputs": ["1"] * len(kinds),
        "input_types": ["3" if kind == CABLE else "0" for kind in kinds],
        "num_outputs": ["1"] * len(kinds),
        "output_types": ["1"] * len(kinds),
    }
    options = [f"{name}={','.join(values)}" for name, values in lists.items()]
    run("modprobe", "vivid", f"n_devs={len(kinds)}", *options)
    run("udevadm", "settle")
    until("the cameras have names", lambda: all(capture(i).exists() for i in range(len(kinds))))


def unbind():
    """Pulls all cameras out while somebody has them open."""
    if (DRIVER / "vivid.0").exists():
        (DRIVER / "unbind").write_text("vivid.0", encoding="ascii")


def bind():
    """Plugs in again what was pulled out so."""
    if DRIVER.exists() and not (DRIVER / "vivid.0").exists():
        (DRIVER / "bind").write_text("vivid.0", encoding="ascii")
    run("udevadm", "settle")


def unload():
    """Takes all cameras away."""
    bind()
    run("modprobe", "-r", "vivid")
    run("udevadm", "settle")


def control(index, **controls):
    """Sets controls of a camera."""
    pairs = ",".join(f"{name}={value}" for name, value in controls.items())
    return run("v4l2-ctl", "-d", capture(index), "--set-ctrl", pairs)


def read(index, name):
    """Reads a control of a camera."""
    return int(run("v4l2-ctl", "-d", capture(index), "--get-ctrl", name).split(": ")[1])


def picture(seed, width, height, code):
    """Bytes that no mistake of a row, a stride or a camera leaves alike."""
    return random.Random(seed).randbytes(width * height * BYTES[code])


class Cable:
    """A picture on its way into a camera, again and again."""

    def __init__(self, index, width, height, code):
        self.index, self.size, self.code = index, (width, height), code
        for device in (capture(index), output(index)):
            # The slowest that a cable carries: under emulation each frame is dear.
            for rate in (6, 7, 8, 10, 15, 20, 24, 30, 36, 50, 60):
                timings = f"cvt,width={width},height={height},fps={rate}"
                said = run("v4l2-ctl", "-d", device, "--set-dv-bt-timings", timings, expected=None)
                if "failed" not in said:
                    break
            else:
                raise Unexpected(f"{device}: {said}")
        control(index, osd_text_mode=2)
        form = f"width={width},height={height},pixelformat={code}"
        run("v4l2-ctl", "-d", output(index), f"--set-fmt-video-out={form}")
        run("v4l2-ctl", "-d", capture(index), f"--set-fmt-video={form}")
        self.process = None

    def feed(self, data):
        """Shows a picture instead of the one before."""
        self.stop()
        path = Path(f"/run/cable-{self.index}")
        path.write_bytes(data)
        command = ["v4l2-ctl", "-d", str(output(self.index)), "--stream-out-mmap=3", "--stream-loop"]
        command.append(f"--stream-from={path}")
        self.process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        control(self.index, loop_video=1)

    def stop(self):
        """Shows nothing."""
        if self.process:
            self.process.terminate()
            self.process.wait()
            self.process = None
