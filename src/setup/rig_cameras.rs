//! Makes a driver for each camera of a configuration. Nothing is opened here.

use super::duplicate_devices;
use crate::calibration::RigCalibration;
use crate::clock::Clock;
use crate::config::Config;
use crate::daemon::{CameraKind, RigCamera};
#[cfg(feature = "aravis")]
use crate::drivers::aravis;
use crate::drivers::aravis::{Parameters as GigeParameters, TriggerMode as GigeTrigger};
use crate::drivers::link::{Transmission, budget};
use crate::drivers::live::{Driver, Pool};
use crate::drivers::pixel_format::PixelFormat;
use crate::drivers::{openni2, v4l2};
use crate::frame::CameraId;
use crate::log;
use crate::sync::{self, FreeRunning};
use crate::words::closest;
use std::collections::BTreeMap;
use std::time::Duration;

/// What drivers share.
#[allow(dead_code, reason = "only the drivers that are built in read it")]
struct Shared<'a> {
    clock: Clock,
    pool: &'a Pool,
    #[cfg(feature = "aravis")]
    actions: aravis::ActionGroup,
}

/// Packets that a network carries without being asked for larger ones, in bytes from the IP header on.
const PLAIN_PACKET: u32 = 1500;

/// The cameras of a configuration.
///
/// # Errors
/// If a camera is named twice, has two names, is set wrongly, is missing in the calibration or has pictures of another
/// size than there, its driver is not in this program, or a link cannot carry what it should.
pub(super) fn rig_cameras(
    config: &Config,
    calibration: Option<&RigCalibration>,
    clock: Clock,
    pool: &Pool,
) -> Result<Vec<RigCamera>, String> {
    let shared = Shared {
        clock,
        pool,
        #[cfg(feature = "aravis")]
        actions: aravis::ActionGroup::default(),
    };
    let mut rig_cameras: BTreeMap<CameraId, RigCamera> = BTreeMap::new();
    for camera in gige_cameras(config, calibration, &shared)? {
        add(&mut rig_cameras, camera)?;
    }
    for camera in v4l2_cameras(config, calibration, &shared)? {
        add(&mut rig_cameras, camera)?;
    }
    for camera in openni2_cameras(config, calibration, &shared)? {
        add(&mut rig_cameras, camera)?;
    }
    let colors: Vec<&str> = rig_cameras
        .values()
        .filter(|s| s.kind == CameraKind::Color)
        .map(|s| s.id.as_str())
        .collect();
    if colors.len() < 2 {
        return Err("expected at least two colour cameras (aravis.cameras, v4l2.cameras)".into());
    }
    know_free_running(&colors, &config.sync.nearest_color)?;
    let calibrated = calibration.iter().flat_map(|c| c.cameras.keys());
    for id in calibrated.filter(|id| !rig_cameras.contains_key(id)) {
        log::warning!("camera {id} is calibrated but not configured, and is ignored");
    }
    Ok(rig_cameras.into_values().collect())
}

fn gige_cameras(
    config: &Config,
    calibration: Option<&RigCalibration>,
    shared: &Shared,
) -> Result<Vec<RigCamera>, String> {
    let camera = |(id, parameters): (CameraId, GigeParameters)| {
        let needs_signal = parameters.trigger_mode() == GigeTrigger::Line;
        let driver = gige_driver(&id, parameters, shared)?;
        Ok(RigCamera {
            id,
            kind: CameraKind::Color,
            needs_signal,
            driver,
        })
    };
    let cameras = staggered(config, calibration)?;
    cameras.into_iter().map(camera).collect()
}

fn v4l2_cameras(
    config: &Config,
    calibration: Option<&RigCalibration>,
    shared: &Shared,
) -> Result<Vec<RigCamera>, String> {
    let camera = |(id, parameters): (CameraId, v4l2::Parameters)| {
        let needs_signal = parameters.trigger() == v4l2::TriggerMode::Line;
        let driver = v4l2_driver(&id, parameters, shared)?;
        Ok(RigCamera {
            id,
            kind: CameraKind::Color,
            needs_signal,
            driver,
        })
    };
    let cameras = checked("v4l2", config.v4l2.each()?, v4l2::Parameters::checked)?;
    duplicate_devices::check_unique_v4l2(&cameras)?;
    for (id, parameters) in &cameras {
        fits_calibration(calibration, id, ["v4l2", "size"], parameters.size)?;
    }
    cameras.into_iter().map(camera).collect()
}

fn openni2_cameras(
    config: &Config,
    calibration: Option<&RigCalibration>,
    shared: &Shared,
) -> Result<Vec<RigCamera>, String> {
    let camera = |(id, mut parameters): (CameraId, openni2::Parameters)| {
        parameters.burst = Some(parameters.burst.unwrap_or(config.sync.depth_frames as u32));
        let kind = if parameters.take_turns() {
            CameraKind::DepthInTurn
        } else {
            CameraKind::Depth
        };
        let driver = openni2_driver(&id, parameters, shared)?;
        Ok(RigCamera {
            id,
            kind,
            needs_signal: false,
            driver,
        })
    };
    let check = |parameters: &openni2::Parameters| {
        parameters.checked()?;
        fits_captures(parameters.burst, &config.sync)
    };
    let cameras = checked("openni2", config.openni2.each()?, check)?;
    duplicate_devices::check_unique_openni2(&cameras)?;
    for (id, parameters) in &cameras {
        fits_calibration(
            calibration,
            id,
            ["openni2", "size"],
            Some(parameters.size()),
        )?;
    }
    cameras.into_iter().map(camera).collect()
}

/// Refuses a burst of which a capture would leave frames out, or that could make none complete.
fn fits_captures(burst: Option<u32>, sync: &sync::Parameters) -> Result<(), String> {
    let (fewest, most) = (sync.min_depth_frames, sync.depth_frames);
    match burst {
        Some(burst) if !(fewest..=most).contains(&(burst as usize)) => Err(format!(
            "burst is {burst}, expected {fewest} to {most} (sync.min_depth_frames and sync.depth_frames)"
        )),
        _ => Ok(()),
    }
}

/// Each camera of a driver, checked, by its id.
fn checked<P>(
    driver: &str,
    cameras: BTreeMap<String, P>,
    check: impl Fn(&P) -> Result<(), String>,
) -> Result<BTreeMap<CameraId, P>, String> {
    let one = |(name, parameters): (String, P)| {
        let place = format!("{driver}.cameras.{name}");
        let id = CameraId::new(&name).map_err(|e| format!("{place}: {e}"))?;
        check(&parameters).map_err(|e| format!("{place}: {e}"))?;
        Ok((id, parameters))
    };
    cameras.into_iter().map(one).collect()
}

fn add(
    rig_cameras: &mut BTreeMap<CameraId, RigCamera>,
    rig_camera: RigCamera,
) -> Result<(), String> {
    let id = rig_camera.id.clone();
    match rig_cameras.insert(id.clone(), rig_camera) {
        Some(_) => Err(format!("camera {id} is configured for two drivers")),
        None => Ok(()),
    }
}

/// Refuses free-running cameras that are none of the rig's colour cameras.
fn know_free_running(colors: &[&str], free_running: &FreeRunning) -> Result<(), String> {
    let FreeRunning::Some(named) = free_running else {
        return Ok(());
    };
    let mut named = named.iter().map(CameraId::as_str);
    let Some(unknown) = named.find(|name| !colors.contains(name)) else {
        return Ok(());
    };
    let tip = closest(unknown, colors.iter().copied());
    let tip = tip.map_or_else(String::new, |known| format!(": did you mean {known:?}?"));
    Err(format!(
        "sync.nearest_color names {unknown:?}, expected colour cameras of this rig, which has {}{tip}",
        colors.join(", ")
    ))
}

/// Refuses a camera that the rig was calibrated without, or with pictures of another size than its settings say.
/// `size` is the one that its driver's setting `field` says, if it does.
fn fits_calibration(
    calibration: Option<&RigCalibration>,
    id: &CameraId,
    [driver, field]: [&str; 2],
    size: Option<[u32; 2]>,
) -> Result<(), String> {
    let Some(calibration) = calibration else {
        return Ok(());
    };
    let Some((camera, _)) = calibration.cameras.get(id) else {
        let known: Vec<&str> = calibration.cameras.keys().map(CameraId::as_str).collect();
        return Err(format!(
            "camera {id} is not in rig.calibration, which has {}: calibrate it, or remove it from the configuration",
            known.join(", ")
        ));
    };
    let expected = [camera.intrinsics.width, camera.intrinsics.height];
    match size {
        Some(size) if size.map(|side| side as usize) != expected => Err(format!(
            "{driver}.cameras.{id}: {field} is {}x{} pixels, expected {}x{}, for which rig.calibration has this camera: \
             change {field}, or calibrate the camera as it is set",
            size[0], size[1], expected[0], expected[1]
        )),
        _ => Ok(()),
    }
}

/// The GigE Vision cameras, those of a link one after the other. How large their pictures are is known from the
/// calibration; without one they send as they are set.
fn staggered(
    config: &Config,
    calibration: Option<&RigCalibration>,
) -> Result<BTreeMap<CameraId, GigeParameters>, String> {
    let mut cameras = checked("aravis", config.aravis.each()?, GigeParameters::checked)?;
    duplicate_devices::check_unique_gige(&cameras)?;
    // Before the links, which know only calibrated cameras.
    for (id, parameters) in &cameras {
        let size = parameters.region.map(|r| [r.width, r.height]);
        fits_calibration(calibration, id, ["aravis", "region"], size)?;
    }
    let Some(calibration) = calibration else {
        for name in config.links.keys() {
            log::warning!(
                "link {name}: without a calibration, the size of its cameras' pictures is not known: they \
                 send at the same time, unless transmission_delay_ns is set"
            );
        }
        return Ok(cameras);
    };
    let transmissions = cameras.iter().filter_map(|(id, parameters)| {
        let (camera, _) = calibration.cameras.get(id)?;
        let pixels = [camera.intrinsics.width, camera.intrinsics.height];
        let bytes = parameters
            .pixel_format
            .and_then(PixelFormat::bytes_per_pixel)
            .unwrap_or(1);
        let transmission = Transmission {
            frame_bytes: (pixels[0] * pixels[1] * bytes) as u64,
            packet_bytes: parameters.packet_size.unwrap_or(PLAIN_PACKET),
            packet_delay_ns: parameters.packet_delay_ns.unwrap_or(0),
        };
        Some((id.clone(), transmission))
    });
    let at_most = config.sync.window_ms + config.capture.patience_ms as f64;
    let at_most = Duration::from_secs_f64(at_most.max(0.0) / 1e3);
    let budget = budget(&config.links, &transmissions.collect(), at_most)?;
    for (name, takes) in &budget.links {
        log::info!(
            "link {name}: a capture takes {:.0} ms",
            takes.as_secs_f64() * 1e3
        );
    }
    for (id, delay_ns) in budget.transmission_delay_ns {
        if let Some(parameters) = cameras.get_mut(&id) {
            parameters.transmission_delay_ns.get_or_insert(delay_ns);
        }
    }
    Ok(cameras)
}

/// A driver that this program was built without.
#[allow(dead_code, reason = "called for the drivers that are not built in")]
fn not_built_in(id: &CameraId, feature: &str) -> String {
    format!("camera {id}: this program was built without the feature {feature}")
}

#[cfg(feature = "aravis")]
fn gige_driver(
    id: &CameraId,
    parameters: GigeParameters,
    shared: &Shared<'_>,
) -> Result<Box<dyn Driver>, String> {
    Ok(Box::new(aravis::GigeDriver::new(
        id.clone(),
        parameters,
        shared.pool.clone(),
        shared.clock,
        shared.actions.clone(),
    )))
}

#[cfg(not(feature = "aravis"))]
fn gige_driver(
    id: &CameraId,
    _: GigeParameters,
    _: &Shared<'_>,
) -> Result<Box<dyn Driver>, String> {
    Err(not_built_in(id, "aravis"))
}

#[cfg(feature = "v4l2")]
fn v4l2_driver(
    id: &CameraId,
    parameters: v4l2::Parameters,
    shared: &Shared<'_>,
) -> Result<Box<dyn Driver>, String> {
    Ok(Box::new(v4l2::V4l2Driver::new(
        id.clone(),
        parameters,
        shared.pool.clone(),
        shared.clock,
    )))
}

#[cfg(not(feature = "v4l2"))]
fn v4l2_driver(
    id: &CameraId,
    _: v4l2::Parameters,
    _: &Shared<'_>,
) -> Result<Box<dyn Driver>, String> {
    Err(not_built_in(id, "v4l2"))
}

#[cfg(feature = "openni2")]
fn openni2_driver(
    id: &CameraId,
    parameters: openni2::Parameters,
    shared: &Shared<'_>,
) -> Result<Box<dyn Driver>, String> {
    Ok(Box::new(openni2::OpenNi2::new(
        id.clone(),
        parameters,
        shared.pool.clone(),
        shared.clock,
    )))
}

#[cfg(not(feature = "openni2"))]
fn openni2_driver(
    id: &CameraId,
    _: openni2::Parameters,
    _: &Shared<'_>,
) -> Result<Box<dyn Driver>, String> {
    Err(not_built_in(id, "openni2"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// A calibration of two cameras, with pictures of 640x480 pixels each.
    fn calibration() -> RigCalibration {
        let camera = |id: &str| {
            format!(
                "[cameras.{id}]\nsize = [640, 480]\nfocal_px = [800.0, 800.0]\ncenter_px = [320.0, 240.0]\n\
                 translation = [0.0, 0.0, 1.0]\nrotation = [1.0, 0.0, 0.0, 0.0]\n"
            )
        };
        let text = format!("format = 1\n{}{}", camera("c00"), camera("c01"));
        RigCalibration::parse(Path::new("calibration.toml"), &text).unwrap()
    }

    /// The GigE Vision cameras of a configuration.
    fn gige(text: &str) -> Result<BTreeMap<CameraId, GigeParameters>, String> {
        staggered(&toml::from_str(text).unwrap(), Some(&calibration()))
    }

    #[test]
    fn a_camera_without_a_calibration_is_named_also_where_a_link_names_it() {
        let link = "[links.left]\nspeed_mbit = 1000\ncameras = ['c00', 'c01']\n";
        let cameras = "[aravis.cameras]\nc00 = { serial = 'a' }\nc01 = { serial = 'b' }\n";
        let sound = format!("{link}{cameras}");
        assert_eq!(gige(&sound).unwrap().len(), 2);
        let refused = gige(&sound.replace("c01", "c11")).unwrap_err();
        assert!(
            refused.starts_with("camera c11 is not in rig.calibration, which has c00, c01: "),
            "{refused}"
        );
        let refused = gige(&sound.replace("'c01'", "'c11'")).unwrap_err();
        assert!(
            refused.contains("\"c11\" is not a GigE Vision"),
            "{refused}"
        );
    }

    #[test]
    fn a_camera_is_set_to_the_size_that_it_was_calibrated_with() {
        let of = |size: &str| {
            gige(&format!(
                "[aravis.defaults]\nregion = {{ {size} }}\n[aravis.cameras.c00]\nserial = 'a'\n"
            ))
        };
        assert_eq!(of("x = 8, width = 640, height = 480").unwrap().len(), 1);
        let refused = of("width = 640, height = 512").unwrap_err();
        let words = "aravis.cameras.c00: region is 640x512 pixels, expected 640x480, for which rig.calibration";
        assert!(refused.starts_with(words), "{refused}");
        // Nothing is known of a size that the camera has by itself, or without a calibration.
        let id = CameraId::new("c01").unwrap();
        let fits = |calibration, size| fits_calibration(calibration, &id, ["v4l2", "size"], size);
        let calibration = calibration();
        assert_eq!(fits(Some(&calibration), None), Ok(()));
        assert_eq!(fits(None, Some([480, 640])), Ok(()));
        assert!(fits(Some(&calibration), Some([480, 640])).is_err());
    }

    #[test]
    fn free_running_cameras_are_colour_cameras_of_the_rig() {
        let some = |name: &str| FreeRunning::Some([CameraId::new(name).unwrap()].into());
        let know = |free_running| know_free_running(&["c00", "c01", "left"], &free_running);
        for known in [FreeRunning::All, FreeRunning::default(), some("c01")] {
            assert_eq!(know(known), Ok(()));
        }
        let close = know(some("letf")).unwrap_err();
        assert_eq!(
            close,
            "sync.nearest_color names \"letf\", expected colour cameras of this rig, which has c00, c01, left: \
             did you mean \"left\"?"
        );
        let far = know(some("kinect")).unwrap_err();
        assert!(far.ends_with("which has c00, c01, left"), "{far}");
    }

    #[test]
    fn a_burst_is_as_long_as_a_capture_can_use() {
        let sync = sync::Parameters::default();
        for burst in [None, Some(10), Some(30)] {
            assert_eq!(fits_captures(burst, &sync), Ok(()));
        }
        for burst in [9, 31] {
            let refused = fits_captures(Some(burst), &sync).unwrap_err();
            assert_eq!(
                refused,
                format!(
                    "burst is {burst}, expected 10 to 30 (sync.min_depth_frames and sync.depth_frames)"
                )
            );
        }
    }
}
