//! Finds a camera: by its address in a few milliseconds, or by serial number or name through a search of about a
//! second, whose result all cameras share. Nothing is configured here.

use super::gvcp::{Identity, identify};
use super::parameters::Parameters;
use crate::drivers::live::Fault;
use aravis::prelude::*;
use aravis::{Camera, GvDevice, GvInterface};
use parking_lot::Mutex;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

/// A camera that answers.
#[derive(Debug, Clone)]
pub(super) struct Found {
    /// Its address.
    pub address: Ipv4Addr,
    /// Who it says it is.
    pub identity: Identity,
}

/// Finds the camera that the parameters mean.
///
/// # Errors
/// If none answers, or another one does.
pub(super) fn find(parameters: &Parameters) -> Result<Found, Fault> {
    let found = match parameters.address {
        Some(address) => ask(address)?,
        None => search(parameters)?,
    };
    if is_meant(parameters, &found.identity) {
        return Ok(found);
    }
    let Identity { serial, name, .. } = &found.identity;
    Err(Fault::Refused {
        field: format!("camera at {}", found.address),
        asked: parameters.address_text(),
        found: format!("serial {serial}, name {name:?}"),
    })
}

/// One camera is opened at a time: the library reads their descriptions into structures that threads spoil for each
/// other (seen with 0.8.26). Each has answered just before, so that none holds up the others for long.
static OPENING: Mutex<()> = Mutex::new(());

/// The library's device and camera of a found camera, which take control of it. Made without the library's own search,
/// which would hold up all other cameras while one does not answer.
///
/// # Errors
/// If the camera does not answer, or obeys somebody else.
pub(super) fn take_control(found: &Found) -> Result<(GvDevice, Camera), Fault> {
    let _alone = OPENING.lock();
    let away = |why: &str| Fault::Away(format!("{}: {why}", found.address));
    let interface = local_address(found.address).map_err(|e| away(&e.to_string()))?;
    let device = GvDevice::new(
        &gio::InetAddress::from(interface),
        &gio::InetAddress::from(IpAddr::V4(found.address)),
    );
    let device = device.map_err(|e| away(e.message()))?;
    if !device.is_controller() {
        return Err(away("another program controls the camera"));
    }
    let camera = Camera::with_device(&device).map_err(|e| away(e.message()))?;
    Ok((device, camera))
}

/// The address of ours from which a camera is reached.
fn local_address(camera: Ipv4Addr) -> std::io::Result<IpAddr> {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
    socket.connect((camera, super::gvcp::PORT))?;
    socket.local_addr().map(|address: SocketAddr| address.ip())
}

fn ask(address: Ipv4Addr) -> Result<Found, Fault> {
    let identity = identify(address);
    let identity = identity.map_err(|e| {
        Fault::Away(format!(
            "no camera answered at {address} ({e}): check its power, cable and address"
        ))
    })?;
    Ok(Found { address, identity })
}

fn is_meant(parameters: &Parameters, identity: &Identity) -> bool {
    let fits = |asked: &Option<String>, found: &str| asked.as_deref().is_none_or(|a| a == found);
    fits(&parameters.serial, &identity.serial) && fits(&parameters.name, &identity.name)
}

/// The last search: when it ended and which cameras it found. Also keeps two threads from searching at once.
static SEARCHED: Mutex<Option<(Instant, Vec<Found>)>> = Mutex::new(None);
/// How long a search holds good for other cameras.
const FRESH: Duration = Duration::from_secs(2);

fn search(parameters: &Parameters) -> Result<Found, Fault> {
    let mut last = SEARCHED.lock();
    let fresh = last.as_ref().filter(|(at, _)| at.elapsed() < FRESH);
    let all = match fresh {
        Some((_, found)) => found.clone(),
        None => everyone(),
    };
    if fresh.is_none() {
        *last = Some((Instant::now(), all.clone()));
    }
    drop(last);
    let mut meant = all.iter().filter(|f| is_meant(parameters, &f.identity));
    let others: Vec<String> = all.iter().map(|f| f.identity.serial.clone()).collect();
    match (meant.next(), meant.next()) {
        (Some(found), None) => Ok(found.clone()),
        (Some(one), Some(other)) => Err(Fault::Refused {
            field: "camera".into(),
            asked: parameters.address_text(),
            found: format!(
                "two cameras that match, at {} and {}",
                one.address, other.address
            ),
        }),
        (None, _) => Err(Fault::Away(format!(
            "no camera {} answered a search; serials found: {}",
            parameters.address_text(),
            if others.is_empty() {
                "none".into()
            } else {
                others.join(", ")
            }
        ))),
    }
}

/// All cameras that answer on any network.
fn everyone() -> Vec<Found> {
    let Some(interface) = GvInterface::instance() else {
        return Vec::new();
    };
    interface.update_device_list();
    let addresses = (0..interface.n_devices()).filter_map(|i| interface.device_address(i));
    let addresses = addresses.filter_map(|a| a.parse::<Ipv4Addr>().ok());
    addresses.filter_map(|address| ask(address).ok()).collect()
}
