//! Computes how long a capture takes on each network link, and when each camera of a link may send: the cameras of one
//! link send one after the other, so that no switch has to hold their frames. It only computes: no packet is sent here.

use crate::frame::CameraId;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// A network link that cameras share: the slowest piece of cable between them and the host.
#[derive(serde::Deserialize, serde::Serialize, Clone, Debug, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Link {
    /// Its speed in megabits a second, such as 1000.
    pub speed_mbit: u32,
    /// The cameras on it, in the order in which they send.
    pub cameras: Vec<String>,
}

/// A frame of a GigE Vision camera on its way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transmission {
    /// Bytes of the picture.
    pub frame_bytes: u64,
    /// Bytes of a packet from its IP header on.
    pub packet_bytes: u32,
    /// Pause between two packets in nanoseconds.
    pub packet_delay_ns: u32,
}

/// IP, UDP and GVSP headers in a packet.
const HEADERS: u32 = 20 + 8 + 8;
/// Ethernet around it: preamble, header, check sequence, gap.
const ETHERNET: u64 = 8 + 14 + 4 + 12;

impl Transmission {
    /// Packets of a frame, its leader and trailer among them.
    fn packets(&self) -> u64 {
        let payload = u64::from(self.packet_bytes.saturating_sub(HEADERS).max(1));
        self.frame_bytes.div_ceil(payload) + 2
    }

    /// How long a frame takes on a link.
    pub fn duration(&self, speed_mbit: u32) -> Duration {
        let bits = (u64::from(self.packet_bytes) + ETHERNET) * 8;
        let packet_ns =
            bits * 1000 / u64::from(speed_mbit.max(1)) + u64::from(self.packet_delay_ns);
        Duration::from_nanos(self.packets().saturating_mul(packet_ns))
    }
}

/// What each link and each camera may expect.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Budget {
    /// How long each camera waits before it sends, in nanoseconds.
    pub transmission_delay_ns: BTreeMap<CameraId, u64>,
    /// How long a capture takes on each link.
    pub links: BTreeMap<String, Duration>,
    /// Cameras that no link names: nothing is known of theirs.
    pub unlinked: Vec<CameraId>,
}

/// Computes when each camera sends.
///
/// # Errors
/// With the arithmetic in words, if a capture takes longer on a link than `at_most`; or a link has no speed, names a
/// camera that is not one of these, or one that another link names too.
pub fn budget(
    links: &BTreeMap<String, Link>,
    cameras: &BTreeMap<CameraId, Transmission>,
    at_most: Duration,
) -> Result<Budget, String> {
    let mut budget = Budget::default();
    let mut named = BTreeSet::new();
    for (name, link) in links {
        if link.speed_mbit == 0 {
            return Err(format!("links.{name}: speed_mbit is 0, expected 1 or more"));
        }
        let mut begin = Duration::ZERO;
        let mut arithmetic = Vec::new();
        for camera in &link.cameras {
            let found = cameras.iter().find(|(id, _)| id.as_str() == camera);
            let Some((id, transmission)) = found else {
                return Err(format!(
                    "links.{name}: {camera:?} is not a GigE Vision camera of this rig"
                ));
            };
            if !named.insert(id) {
                return Err(format!("links.{name}: {camera} is on another link already"));
            }
            let takes = transmission.duration(link.speed_mbit);
            budget
                .transmission_delay_ns
                .insert(id.clone(), begin.as_nanos() as u64);
            begin += takes;
            arithmetic.push(words(camera, transmission, takes));
        }
        if begin > at_most {
            return Err(format!(
                "links.{name}: a capture takes {:.0} ms at {} Mbit/s, expected at most {:.0} ms (sync.window_ms and \
                 capture.patience_ms): {}",
                begin.as_secs_f64() * 1e3,
                link.speed_mbit,
                at_most.as_secs_f64() * 1e3,
                arithmetic.join("; ")
            ));
        }
        budget.links.insert(name.clone(), begin);
    }
    let unlinked = cameras.keys().filter(|id| !named.contains(id));
    budget.unlinked = unlinked.cloned().collect();
    Ok(budget)
}

fn words(camera: &str, transmission: &Transmission, takes: Duration) -> String {
    let pause = match transmission.packet_delay_ns {
        0 => String::new(),
        ns => format!(" and pauses of {ns} ns"),
    };
    format!(
        "{camera} {} bytes in {} packets of {} bytes{pause}: {:.1} ms",
        transmission.frame_bytes,
        transmission.packets(),
        transmission.packet_bytes,
        takes.as_secs_f64() * 1e3
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rig(count: usize, frame_bytes: u64) -> (BTreeMap<CameraId, Transmission>, Vec<String>) {
        let names: Vec<String> = (0..count).map(|i| format!("c{i:02}")).collect();
        let transmission = Transmission {
            frame_bytes,
            packet_bytes: 9000,
            packet_delay_ns: 0,
        };
        let ids = names
            .iter()
            .map(|n| (CameraId::new(n).unwrap(), transmission));
        (ids.collect(), names)
    }

    fn one_link(speed_mbit: u32, cameras: Vec<String>) -> BTreeMap<String, Link> {
        let link = Link {
            speed_mbit,
            cameras,
        };
        BTreeMap::from([("eth1".to_owned(), link)])
    }

    #[test]
    fn eleven_frames_over_a_gigabit_take_half_a_second_one_after_the_other() {
        let (cameras, names) = rig(11, 2560 * 1920);
        let links = one_link(1000, names);
        let budget = budget(&links, &cameras, Duration::from_secs(3)).unwrap();
        // 549 packets of 9038 bytes each.
        let one_ns = 551 * 9038 * 8;
        assert!(
            budget.links["eth1"].abs_diff(Duration::from_nanos(11 * one_ns))
                < Duration::from_millis(1)
        );
        let delays: Vec<u64> = budget.transmission_delay_ns.into_values().collect();
        assert_eq!(delays[0], 0);
        assert!(
            delays
                .windows(2)
                .all(|d| (d[1] - d[0]).abs_diff(one_ns) < 100_000)
        );
    }

    #[test]
    fn what_cannot_work_is_refused_with_its_arithmetic() {
        let (cameras, names) = rig(11, 2560 * 1920);
        let slow = budget(
            &one_link(100, names.clone()),
            &cameras,
            Duration::from_secs(3),
        );
        let message = slow.unwrap_err();
        for part in [
            "links.eth1",
            "100 Mbit/s",
            "3000 ms",
            "c10",
            "4915200 bytes",
        ] {
            assert!(message.contains(part), "{message}");
        }
        let mut links = one_link(1000, names);
        links.insert("eth2".into(), links["eth1"].clone());
        let twice = budget(&links, &cameras, Duration::from_secs(3)).unwrap_err();
        assert!(twice.contains("c00 is on another link already"), "{twice}");
        let unknown = one_link(1000, vec!["k0".into()]);
        let unknown = budget(&unknown, &cameras, Duration::from_secs(3)).unwrap_err();
        assert!(unknown.contains("\"k0\""), "{unknown}");
        assert!(budget(&one_link(0, vec![]), &cameras, Duration::ZERO).is_err());
    }

    #[test]
    fn pauses_between_packets_count() {
        let (cameras, _) = rig(1, 1_000_000);
        let without = *cameras.values().next().unwrap();
        let with = Transmission {
            packet_delay_ns: 10_000,
            ..without
        };
        let more = with.duration(1000) - without.duration(1000);
        assert_eq!(more.as_nanos(), u128::from(10_000 * without.packets()));
    }
}
