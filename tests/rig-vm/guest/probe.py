"""Tries what the daemon must not do, without changing anything, and prints the result of each attempt: null if it was
allowed, otherwise the reason why not."""

import ctypes
import errno
import json
import mmap
import os
import pathlib
import socket
import subprocess
import time

libc = ctypes.CDLL(None, use_errno=True)
tried = {}


def attempt(what):
    def go(function):
        try:
            function()
            tried[what] = None
        except OSError as error:
            tried[what] = errno.errorcode.get(error.errno or 0, str(error))
        except Exception as error:
            tried[what] = repr(error)

    return go


def call(name, *arguments):
    if getattr(libc, name)(*arguments) == -1:
        raise OSError(ctypes.get_errno(), name)


def write(path):
    with open(path, "w", encoding="ascii"):
        pass
    os.unlink(path)


def device(path, mode="rb+"):
    open(path, mode, buffering=0).close()


def first(pattern):
    folder, _, name = pattern.rpartition("/")
    return sorted(pathlib.Path(folder).glob(name))[0]


def send(address):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        sender.sendto(b"x", (address, 9))


attempt("write its recordings")(lambda: write("/var/lib/scand/recordings/probe"))
attempt("read and write a camera")(lambda: device(first("/dev/rig/*-cap")))
attempt("read and write a USB device")(lambda: device(first("/dev/scand/depth/*")))
attempt("send to a private address")(lambda: send("192.168.10.10"))
attempt("send to an address of the world")(lambda: send("192.0.2.1"))
attempt("write /etc")(lambda: write("/etc/probe"))
attempt("write /usr")(lambda: write("/usr/probe"))
attempt("write /run")(lambda: write("/run/probe"))
attempt("read /home")(lambda: os.listdir("/home"))
attempt("read /root")(lambda: os.listdir("/root"))
attempt("read a foot switch")(lambda: device(first("/dev/input/event*"), "rb"))
attempt("read the memory")(lambda: device("/dev/mem", "rb"))
attempt("write the kernel's log")(lambda: device("/dev/kmsg", "wb"))
attempt("write a terminal")(lambda: device("/dev/ttyS0", "wb"))
attempt("see other processes")(lambda: os.stat("/proc/1"))
attempt("signal other processes")(lambda: os.kill(1, 0))
attempt("read the kernel's log")(lambda: call("klogctl", 3, ctypes.create_string_buffer(16), 16))
attempt("set the clock")(lambda: time.clock_settime(time.CLOCK_REALTIME, time.time()))
attempt("set the host's name")(lambda: socket.sethostname(socket.gethostname()))
attempt("make memory that is written and run")(lambda: mmap.mmap(-1, 4096, prot=7).close())
attempt("change what the kernel is set to")(lambda: device("/proc/sys/kernel/printk"))
attempt("become root")(lambda: os.setuid(0))
attempt("start a program")(lambda: subprocess.run(["/bin/true"], check=True))


@attempt("hear of devices from the kernel")
def _():
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, 15) as listener:
        listener.bind((0, 1))


@attempt("read packets as they come")
def _():
    socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(3)).close()


@attempt("use another family of sockets")
def _():
    socket.socket(socket.AF_INET6, socket.SOCK_DGRAM).close()


@attempt("make a device")
def _():
    os.mknod("/var/lib/scand/probe", 0o020600, os.makedev(1, 3))
    os.unlink("/var/lib/scand/probe")


@attempt("make a program that runs as its owner")
def _():
    path = "/var/lib/scand/probe"
    os.close(os.open(path, os.O_CREAT | os.O_WRONLY, 0o600))
    try:
        os.chmod(path, 0o4755)
    finally:
        os.unlink(path)


@attempt("load a module")
def _():
    try:
        call("syscall", 313, -1, b"", 0)  # finit_module
    except OSError as error:
        if error.errno != errno.EBADF:  # no file was given: more than that is not wrong
            raise


@attempt("mount")
def _():
    call("mount", b"none", b"/mnt", b"tmpfs", 0, None)
    call("umount", b"/mnt")


@attempt("make a namespace")
def _():
    call("unshare", 0x04000000)  # CLONE_NEWUTS


@attempt("take real time")
def _():
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


print(json.dumps(tried), flush=True)
