//! Checks the machine by the kernel's own files: network, kernel modules, USB.

use super::{Finding, State};
use crate::words::count;
use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};

/// Receive buffer that a burst of eleven cameras needs, in bytes.
const RECEIVE_BUFFER: u64 = 32 << 20;
/// How long a Kinect must be powered until its depth stops drifting, in minutes.
const WARM_MINUTES: u64 = 60;

/// A machine, read through its `/proc` and `/sys`.
#[derive(Clone, Debug)]
pub struct Host {
    root: PathBuf,
}

impl Default for Host {
    fn default() -> Self {
        Self::below(Path::new("/"))
    }
}

impl Host {
    /// A machine whose `/proc` and `/sys` lie below a folder.
    pub fn below(root: &Path) -> Self {
        Self { root: root.into() }
    }

    fn read(&self, path: &str) -> Option<String> {
        let text = std::fs::read_to_string(self.root.join(path)).ok()?;
        Some(text.trim().to_owned())
    }

    /// Checks that the kernel's receive buffer holds the packets of all cameras.
    pub fn receive_buffers(&self) -> Finding {
        let subject = "receive buffers";
        let found = self.read("proc/sys/net/core/rmem_max");
        match found.and_then(|text| text.parse::<u64>().ok()) {
            Some(bytes) if bytes >= RECEIVE_BUFFER => {
                Finding::ok(subject, format!("net.core.rmem_max is {bytes}"))
            }
            Some(bytes) => Finding::not_ok(
                State::Advice,
                subject,
                format!("net.core.rmem_max is {bytes}, expected {RECEIVE_BUFFER}"),
                format!(
                    "run sysctl -w net.core.rmem_max={RECEIVE_BUFFER} (the package's sysctl.d does it at boot)"
                ),
            ),
            None => Finding::not_ok(
                State::Advice,
                subject,
                "net.core.rmem_max cannot be read",
                "run this check outside a container",
            ),
        }
    }

    /// Checks that a camera's packets fit the network interface that leads to it.
    pub fn packet_size(
        &self,
        camera: &str,
        address: Ipv4Addr,
        packet_size: Option<u32>,
    ) -> Finding {
        let subject = format!("camera {camera}: network");
        let Some(interface) = self.interface_to(address) else {
            return Finding::not_ok(
                State::Wrong,
                subject,
                format!("no interface leads to {address}"),
                "give the interface an address in the camera's subnet, and plug the cable in",
            );
        };
        let mtu = self.read(&format!("sys/class/net/{interface}/mtu"));
        let Some(mtu) = mtu.and_then(|text| text.parse::<u32>().ok()) else {
            return Finding::ok(subject, interface);
        };
        match packet_size {
            Some(packet) if packet > mtu => Finding::not_ok(
                State::Wrong,
                subject,
                format!("packets of {packet} bytes do not fit {interface}, whose MTU is {mtu}"),
                format!("run ip link set dev {interface} mtu 9000, or set a smaller packet_size"),
            ),
            _ if mtu < 4000 => Finding::not_ok(
                State::Advice,
                subject,
                format!("{interface} has an MTU of {mtu}"),
                format!(
                    "use jumbo frames: run ip link set dev {interface} mtu 9000, enable them at the switch, and set packet_size = 8000"
                ),
            ),
            _ => Finding::ok(subject, format!("{interface}, MTU {mtu}")),
        }
    }

    /// The interface with the most specific route to an address.
    fn interface_to(&self, address: Ipv4Addr) -> Option<String> {
        if address.is_loopback() {
            return Some("lo".into());
        }
        // The kernel prints addresses in hexadecimal, in the machine's byte order.
        let number = |text: &str| u32::from_str_radix(text, 16).ok().map(u32::from_be);
        let wanted = u32::from(address);
        let routes = self.read("proc/net/route")?;
        let route = |line: &str| {
            let columns: Vec<&str> = line.split_whitespace().collect();
            let (to, mask) = (number(columns.get(1)?)?, number(columns.get(7)?)?);
            (wanted & mask == to).then(|| (mask, columns[0].to_owned()))
        };
        let narrowest = routes.lines().skip(1).filter_map(route).max_by_key(|r| r.0);
        narrowest.map(|(_, interface)| interface)
    }

    /// Checks that the kernel's own driver does not hold the Kinect.
    pub fn kinect_driver(&self) -> Finding {
        let modules = self.read("proc/modules").unwrap_or_default();
        if modules
            .lines()
            .any(|line| line.starts_with("gspca_kinect "))
        {
            return Finding::not_ok(
                State::Wrong,
                "Kinect: kernel driver",
                "gspca_kinect is loaded and holds the camera",
                "run modprobe -r gspca_kinect; 'blacklist gspca_kinect' in a file in /etc/modprobe.d keeps it unloaded",
            );
        }
        Finding::ok("Kinect: kernel driver", "gspca_kinect is not loaded")
    }

    /// Checks of each Kinect on USB that it has warmed up and is never suspended. Empty if there is no Kinect.
    pub fn kinects(&self) -> Vec<Finding> {
        let folder = self.root.join("sys/bus/usb/devices");
        let devices = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let mut names: Vec<String> = devices
            .filter_map(|device| device.file_name().into_string().ok())
            .collect();
        names.sort();
        let kinects = names.iter().filter(|name| {
            let id = |part: &str| self.read(&format!("sys/bus/usb/devices/{name}/{part}"));
            id("idVendor").as_deref() == Some("045e")
                && matches!(id("idProduct").as_deref(), Some("02ae" | "02bf"))
        });
        kinects.flat_map(|name| self.kinect(name)).collect()
    }

    fn kinect(&self, name: &str) -> Vec<Finding> {
        let power = |part: &str| self.read(&format!("sys/bus/usb/devices/{name}/power/{part}"));
        let mut findings = Vec::new();
        let connected = power("connected_duration").and_then(|text| text.parse::<u64>().ok());
        if let Some(minutes) = connected.map(|ms| ms / 60_000) {
            let (subject, found) = (
                "Kinect: warm-up",
                format!("{} on USB port {name}", count(minutes as usize, "minute")),
            );
            findings.push(if minutes >= WARM_MINUTES {
                Finding::ok(subject, found)
            } else {
                let rest = count((WARM_MINUTES - minutes) as usize, "minute");
                let remedy = format!("its depth drifts while it warms up: wait {rest}");
                Finding::not_ok(State::Advice, subject, found, remedy)
            });
        }
        if power("control").is_some_and(|control| control != "on") {
            findings.push(Finding::not_ok(
                State::Advice,
                "Kinect: suspend",
                format!("the kernel may suspend it on USB port {name}"),
                format!("run echo on > /sys/bus/usb/devices/{name}/power/control (the package's udev rule does it)"),
            ));
        }
        findings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A machine made of files.
    fn host(files: &[(&str, &str)]) -> (tempfile::TempDir, Host) {
        let folder = tempfile::tempdir().unwrap();
        for (path, text) in files {
            let path = folder.path().join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        }
        let host = Host::below(folder.path());
        (folder, host)
    }

    const ROUTES: &str = "Iface\tDestination\tGateway\tFlags\tRefCnt\tUse\tMetric\tMask\tMTU\tWindow\tIRTT\n\
        eth0\t00000000\t0102A8C0\t0003\t0\t0\t0\t00000000\t0\t0\t0\n\
        eth1\t000A000A\t00000000\t0001\t0\t0\t0\t00FFFFFF\t0\t0\t0\n";

    #[test]
    fn packets_must_fit_the_interface_that_leads_to_the_camera() {
        let camera = Ipv4Addr::new(10, 0, 10, 7);
        let with = |mtu: &str| {
            host(&[
                ("proc/net/route", ROUTES),
                ("sys/class/net/eth1/mtu", mtu),
                ("sys/class/net/eth0/mtu", "1500"),
            ])
        };
        let (_folder, jumbo) = with("9000\n");
        assert_eq!(
            jumbo.packet_size("c00", camera, Some(8000)).state,
            State::Ok
        );
        let far = jumbo.packet_size("c00", Ipv4Addr::new(8, 8, 8, 8), None);
        assert!(
            far.found.contains("eth0") && far.state == State::Advice,
            "{far:?}"
        );
        let (_folder, plain) = with("1500\n");
        let wrong = plain.packet_size("c00", camera, Some(8000));
        assert_eq!(wrong.state, State::Wrong);
        assert!(
            wrong.found.contains("eth1") && wrong.found.contains("1500"),
            "{wrong:?}"
        );
        let (_folder, empty) = host(&[("proc/net/route", "Iface\n")]);
        assert_eq!(empty.packet_size("c00", camera, None).state, State::Wrong);
    }

    #[test]
    fn small_receive_buffers_and_the_driver_that_steals_are_told() {
        let (_folder, bad) = host(&[
            ("proc/sys/net/core/rmem_max", "212992\n"),
            (
                "proc/modules",
                "uvcvideo 1 0\ngspca_kinect 16384 0 - Live 0x0\n",
            ),
        ]);
        assert!(bad.receive_buffers().remedy.unwrap().contains("33554432"));
        assert_eq!(bad.kinect_driver().state, State::Wrong);
        let (_folder, good) = host(&[
            ("proc/sys/net/core/rmem_max", "33554432\n"),
            ("proc/modules", "gspca_kinect_other 1 0\n"),
        ]);
        assert_eq!(good.receive_buffers().state, State::Ok);
        assert_eq!(good.kinect_driver().state, State::Ok);
    }

    #[test]
    fn a_cold_kinect_wants_time() {
        let at = |ms: &'static str, control: &'static str| {
            host(&[
                ("sys/bus/usb/devices/1-2/idVendor", "045e\n"),
                ("sys/bus/usb/devices/1-2/idProduct", "02ae\n"),
                ("sys/bus/usb/devices/1-2/power/connected_duration", ms),
                ("sys/bus/usb/devices/1-2/power/control", control),
                ("sys/bus/usb/devices/1-3/idVendor", "1234\n"),
            ])
        };
        let (_folder, cold) = at("600000", "auto\n");
        let states: Vec<State> = cold.kinects().iter().map(|f| f.state).collect();
        assert_eq!(states, [State::Advice, State::Advice]);
        assert!(
            cold.kinects()[0]
                .remedy
                .as_ref()
                .unwrap()
                .contains("50 minutes")
        );
        let (_folder, warm) = at("3600000", "on\n");
        assert_eq!(warm.kinects().len(), 1);
        assert_eq!(warm.kinects()[0].state, State::Ok);
        let (_folder, none) = host(&[]);
        assert!(none.kinects().is_empty());
    }
}
