"""USB devices that the kernel plays to itself: a gadget on a controller that is none (dummy_hcd)."""

from pathlib import Path

from harness import run, until

ROOT = Path("/sys/kernel/config/usb_gadget")
CONTROLLER = "dummy_udc.0"
# Where the host has it, at the only port of the same controller.
HOST = Path("/sys/devices/platform/dummy_hcd.0")
# A keyboard's report, as every keyboard describes it at boot.
KEYBOARD = bytes.fromhex(
    "05010906a101050719e029e71500250175019508810295017508810395057501050819012905910295017503910395067508150025650507"
    "190029658100c0"
)


class Gadget:
    """A USB device with a keyboard in it, under any number."""

    def __init__(self, vendor, product, name, serial="1"):
        if not ROOT.exists():
            run("modprobe", "-a", "dummy_hcd", "libcomposite", "usb_f_hid")
            run("mount", "-t", "configfs", "none", "/sys/kernel/config", expected=None)
        self.folder = ROOT / f"g{vendor:04x}{product:04x}"
        function, configuration = self.folder / "functions/hid.0", self.folder / "configs/c.1"
        for folder in ("strings/0x409", "configs/c.1/strings/0x409", "functions/hid.0"):
            (self.folder / folder).mkdir(parents=True)
        for path, value in {
            "idVendor": f"0x{vendor:04x}",
            "idProduct": f"0x{product:04x}",
            "bDeviceClass": "0",
            "strings/0x409/manufacturer": "scand",
            "strings/0x409/product": name,
            "strings/0x409/serialnumber": serial,
            "configs/c.1/strings/0x409/configuration": "one",
            "functions/hid.0/protocol": "1",
            "functions/hid.0/subclass": "1",
            "functions/hid.0/report_length": "8",
        }.items():
            (self.folder / path).write_text(value, encoding="ascii")
        (function / "report_desc").write_bytes(KEYBOARD)
        (configuration / "hid.0").symlink_to(function)

    def plug_in(self):
        """Plugs it in."""
        (self.folder / "UDC").write_text(CONTROLLER, encoding="ascii")
        until("the gadget is there", lambda: Path("/dev/hidg0").exists())
        until("it is configured", lambda: Path(f"/sys/class/udc/{CONTROLLER}/state").read_text().strip() == "configured")
        until("the host has it", lambda: any(Path("/sys/bus/usb/drivers/usbhid").glob("*:*")))
        run("udevadm", "settle")

    def pull_out(self):
        """Pulls it out."""
        (self.folder / "UDC").write_text("\n", encoding="ascii")
        # The host takes notice in its own time, and there is nothing to settle before it has.
        until("the host has lost it", lambda: not any(HOST.glob("usb*/*-1")))
        run("udevadm", "settle")

    def report(self, key):
        """Sends that this key is down, 0 for none."""
        with open("/dev/hidg0", "wb", buffering=0) as device:
            device.write(bytes([0, 0, key, 0, 0, 0, 0, 0]))

    def remove(self):
        """Takes it away for good."""
        if (self.folder / "UDC").read_text().strip():
            self.pull_out()
        (self.folder / "configs/c.1/hid.0").unlink()
        for folder in ("configs/c.1/strings/0x409", "configs/c.1", "functions/hid.0", "strings/0x409", ""):
            (self.folder / folder).rmdir()
