//! Plays the colour cameras of a recording as GigE Vision cameras on addresses of this machine, with faults that
//! can be switched while they run.

use super::gige::{Player, Scene};
use super::pictures::{Album, Captures, Shown};
use crate::Error;
use parking_lot::{Mutex, MutexGuard};
use scand_core::frame::{CameraId, Timestamp};
use scand_core::recording::Recording;
use std::collections::BTreeMap;
use std::net::{Ipv4Addr, UdpSocket};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// How the colour cameras are served.
#[derive(Debug, Clone, PartialEq)]
pub struct ColorOptions {
    /// Address of the first camera, in the order of their ids; the others follow. Each must be an address of this
    /// machine; loopback's are only known to a program that asks for interfaces when they were added
    /// (`ip address add 127.0.1.1/8 dev lo`).
    pub first_address: Ipv4Addr,
    /// How often a camera looks for a trigger: what bounds how late an exposure is.
    pub polls_per_second: f64,
    /// A GenICam description in the place of the simulator's own.
    pub features: Option<PathBuf>,
}

impl Default for ColorOptions {
    fn default() -> Self {
        Self {
            first_address: Ipv4Addr::new(127, 0, 1, 1),
            polls_per_second: 200.0,
            features: None,
        }
    }
}

/// The colour cameras of a recording, served. They end when this is dropped.
///
/// Each software trigger is answered with one picture: those of the recording's complete captures, in their order.
/// Bayer, grey and RGB pictures are sent as they are, all others as RGB. A camera's clock runs from when it is switched
/// on, and can be latched.
pub struct ColorRig {
    stations: BTreeMap<CameraId, ServedCamera>,
    players: Players,
    captures: Vec<Timestamp>,
    options: ColorOptions,
    ended: Arc<AtomicBool>,
    hardware: Option<JoinHandle<()>>,
}

/// The cameras that are switched on; shared with the thread that plays their hardware.
type Players = Arc<Mutex<BTreeMap<CameraId, Player>>>;

/// A camera's place, which stays while the camera is off.
struct ServedCamera {
    address: Ipv4Addr,
    serial: String,
    scene: Arc<Scene>,
    /// Discards packets for a camera that is off without an answer, as an unplugged camera does.
    silence: Mutex<Option<UdpSocket>>,
}

const GVCP_PORT: u16 = 3956;

impl ColorRig {
    /// Switches all colour cameras of a recording on.
    ///
    /// # Errors
    /// If the recording has no complete capture or a picture cannot be read, or an address is not one of this machine
    /// or taken.
    pub fn start(recording: Arc<Recording>, options: ColorOptions) -> Result<Self, Error> {
        let captures = Captures::list(&recording)?;
        let mut stations = BTreeMap::new();
        for (i, (id, messages)) in captures.cameras.into_iter().enumerate() {
            let address = u32::from(options.first_address).wrapping_add(i as u32);
            let (album, first) = Album::open(recording.clone(), id.clone(), messages)?;
            let station = ServedCamera {
                address: address.into(),
                serial: serial(&id, i),
                scene: Arc::new(Scene::new(album, first)),
                silence: Mutex::default(),
            };
            stations.insert(id, station);
        }
        let mut rig = Self {
            stations,
            players: Players::default(),
            captures: captures.times,
            options,
            ended: Arc::default(),
            hardware: None,
        };
        let ids: Vec<CameraId> = rig.stations.keys().cloned().collect();
        for id in &ids {
            rig.start_camera(id)?;
        }
        rig.hardware = Some(rig.run_hardware()?);
        Ok(rig)
    }

    /// The cameras, with their addresses and serial numbers.
    pub fn cameras(&self) -> impl Iterator<Item = (&CameraId, Ipv4Addr, &str)> {
        let stations = self.stations.iter();
        stations.map(|(id, station)| (id, station.address, station.serial.as_str()))
    }

    /// When each of the captures that are shown was triggered in the recording.
    pub fn captures(&self) -> &[Timestamp] {
        &self.captures
    }

    /// Switches a camera off, as if it was unplugged.
    ///
    /// # Errors
    /// If there is no such camera.
    pub fn stop_camera(&self, id: &CameraId) -> Result<(), Error> {
        let station = self.station(id)?;
        let stopped = self.players().remove(id);
        // Its thread is joined without holding up the others.
        drop(stopped);
        let silence = UdpSocket::bind((station.address, GVCP_PORT));
        *station.silence.lock() = silence.ok();
        Ok(())
    }

    /// Switches a camera on again; one that is on stays so.
    ///
    /// # Errors
    /// If there is no such camera, or its address is taken.
    pub fn start_camera(&self, id: &CameraId) -> Result<(), Error> {
        if self.players().contains_key(id) {
            return Ok(());
        }
        let station = self.station(id)?;
        let unservable =
            |why: String| Error::Unservable(format!("camera {id} on {}: {why}", station.address));
        *station.silence.lock() = None;
        // The simulator would not tell.
        let free = UdpSocket::bind((station.address, GVCP_PORT));
        drop(free.map_err(|e| unservable(e.to_string()))?);
        let features = self
            .options
            .features
            .as_ref()
            .map(|path| path.to_string_lossy());
        let player = Player::start(
            &station.address.to_string(),
            &station.serial,
            features.as_deref(),
            self.options.polls_per_second,
            station.scene.clone(),
        );
        let player = player.ok_or_else(|| unservable("no interface has this address".into()))?;
        player.follow_loss();
        self.players().insert(id.clone(), player);
        Ok(())
    }

    /// Loses a part of a camera's packets, 0 to 1, also after it was off.
    ///
    /// # Errors
    /// If there is no such camera; so for all that follow.
    pub fn set_loss(&self, id: &CameraId, ratio: f64) -> Result<(), Error> {
        self.station(id)?.scene.set_loss(ratio.clamp(0.0, 1.0));
        self.with(id, Player::follow_loss);
        Ok(())
    }

    /// Sends a camera's pictures this long after their exposure.
    pub fn set_delay(&self, id: &CameraId, delay: Duration) -> Result<(), Error> {
        self.station(id)?.scene.set_delay(delay);
        Ok(())
    }

    /// Sends a camera's pictures over a link of so many bytes a second; 0 for one without a limit.
    pub fn set_link(&self, id: &CameraId, bytes_per_second: u64) -> Result<(), Error> {
        self.station(id)?.scene.set_link(bytes_per_second);
        Ok(())
    }

    /// Sends the first picture after a change of a camera's binning this much later.
    pub fn set_switch_time(&self, id: &CameraId, time: Duration) -> Result<(), Error> {
        self.station(id)?.scene.set_switch_time(time);
        Ok(())
    }

    /// Stops a camera's clock, or lets it go on.
    pub fn freeze_clock(&self, id: &CameraId, frozen: bool) {
        self.with(id, |player| player.freeze_clock(frozen));
    }

    /// What the clock of a camera that is on shows, in nanoseconds.
    pub fn clock_ns(&self, id: &CameraId) -> Option<u64> {
        self.with(id, Player::clock_ns)
    }

    /// Shows something else to all cameras from their next picture on.
    pub fn show(&self, shown: Shown) {
        for station in self.stations.values() {
            station.scene.show(shown);
        }
    }

    /// A pulse on what triggers a camera; whether it waited for one other than the software's and took a picture.
    pub fn pulse_line(&self, id: &CameraId) -> bool {
        let line = self.with(id, Player::line);
        line.is_some_and(|line| line.pulse())
    }

    /// Pictures that a camera has sent since the start.
    pub fn served(&self, id: &CameraId) -> Result<u64, Error> {
        Ok(self.station(id)?.scene.served())
    }

    /// Whether a camera had to show black, because its picture could not be read.
    pub fn broken(&self, id: &CameraId) -> Result<bool, Error> {
        Ok(self.station(id)?.scene.broken())
    }

    /// A register of a camera that is on.
    pub fn register(&self, id: &CameraId, address: u32) -> Option<u32> {
        self.with(id, |player| player.read_register(address))
            .flatten()
    }

    /// Writes a register of a camera, as if the camera did.
    pub fn set_register(&self, id: &CameraId, address: u32, value: u32) {
        self.with(id, |player| player.write_register(address, value));
    }

    fn players(&self) -> MutexGuard<'_, BTreeMap<CameraId, Player>> {
        self.players.lock()
    }

    fn with<T>(&self, id: &CameraId, f: impl FnOnce(&Player) -> T) -> Option<T> {
        self.players().get(id).map(f)
    }

    fn station(&self, id: &CameraId) -> Result<&ServedCamera, Error> {
        let station = self.stations.get(id);
        station.ok_or_else(|| Error::Unservable(format!("there is no colour camera {id}")))
    }

    /// A thread that does what cameras' hardware does at once, and the simulator late or not at all.
    fn run_hardware(&self) -> Result<JoinHandle<()>, Error> {
        let (players, ended) = (self.players.clone(), self.ended.clone());
        let run = move || {
            while !ended.load(Ordering::Relaxed) {
                let players = players.lock();
                players.values().for_each(Player::look);
                drop(players);
                std::thread::sleep(Duration::from_micros(500));
            }
        };
        let thread = std::thread::Builder::new()
            .name("hardware".into())
            .spawn(run);
        thread.map_err(|e| {
            Error::Unservable(format!(
                "cannot start a thread for the cameras' \
            hardware: {e}"
            ))
        })
    }
}

impl Drop for ColorRig {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        if let Some(thread) = self.hardware.take() {
            let _ = thread.join();
        }
        self.players().clear();
    }
}

/// A camera's serial number: its id, where there is room for it.
fn serial(id: &CameraId, index: usize) -> String {
    match id.as_str() {
        short if short.len() < 16 => short.into(),
        _ => format!("camera{index:02}"),
    }
}
