//! Reads the configuration's file and prepares everything that a daemon needs before it opens a camera.

use super::line_trigger::allow_for_lines;
use super::rig_cameras::rig_cameras;
use crate::calibration::{
    CalibrationRecord, Camera, DepthCamera, DepthResponse, RigCalibration, Volume,
};
use crate::clock::Clock;
use crate::config::{self, Config};
use crate::daemon::look::protocol::SegmentationSettings;
use crate::daemon::{CameraKind, RigCamera};
use crate::drivers::live::Pool;
use crate::frame::CameraId;
use crate::log;
use crate::recording::SessionHeader;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Where the rig's configuration is.
#[derive(Clone, Debug)]
pub struct ConfigSource {
    /// Its file (TOML).
    pub config: PathBuf,
    /// Values over it, `KEY=VALUE` each.
    pub set: Vec<String>,
}

/// Why a rig cannot be run.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Error {
    /// The configuration cannot be read, or a value is not what it should be.
    #[error(transparent)]
    Configuration(#[from] config::Error),
    /// A configuration, or the calibration that it names, that no rig can have.
    #[error("configuration {}: {problem}", file.display())]
    Refused {
        file: PathBuf,
        /// The field, what was found, and what was expected.
        problem: String,
    },
    /// A file or the working folder that cannot be read.
    #[error("{what}: {cause}")]
    Read { what: String, cause: std::io::Error },
}

/// A rig that could be run.
pub struct Prepared {
    /// The configuration, its paths absolute.
    pub config: Config,
    /// The cameras with their drivers.
    pub rig_cameras: Vec<RigCamera>,
    /// What every recording begins with.
    pub header: SessionHeader,
    /// Memory for frames.
    pub pool: Pool,
    /// Where the calibration is; `None` of a rig that is not calibrated yet.
    pub calibration: Option<PathBuf>,
    /// What a look cuts objects out with; `None` of a rig that is not calibrated yet.
    pub cutting: Option<Arc<SegmentationSettings>>,
}

impl ConfigSource {
    /// Reads configuration and calibration and makes a driver for each camera; opens none.
    ///
    /// # Errors
    /// If one of them is bad.
    pub fn prepare(&self, clock: Clock) -> Result<Prepared, Error> {
        let mut config = Config::load(Some(&self.config), &self.set)?;
        if config.workers.folder.as_os_str().is_empty() {
            config.workers.folder = config.recording.folder.with_file_name("models");
        }
        // Libraries of cameras change the working folder of a process for moments.
        for path in [
            &mut config.recording.folder,
            &mut config.socket.path,
            &mut config.workers.folder,
        ] {
            *path = std::path::absolute(&*path).map_err(unread("working folder", path))?;
        }
        let named = |problem| Error::Refused {
            file: self.config.clone(),
            problem,
        };
        allow_for_lines(&mut config).map_err(named)?;
        let text =
            std::fs::read_to_string(&self.config).map_err(unread("configuration", &self.config))?;
        config.hooks.checked().map_err(named)?;
        let file = self.calibration(&config);
        if file.is_none() {
            log::warning!(
                "there is no rig.calibration: captures are recorded, which scand calibrate can use, but no models are \
                 made"
            );
            config.workers.count = 0;
            config.workers.fleet = None;
        }
        let load =
            |file: &PathBuf| RigCalibration::load_with_text(file).map_err(|e| named(e.to_string()));
        let loaded = file.as_ref().map(load).transpose()?;
        let calibration = loaded.as_ref().map(|(calibration, _)| calibration);
        let pool = Pool::new(config.capture.memory_mb.saturating_mul(1_000_000));
        let rig_cameras = rig_cameras(&config, calibration, clock, &pool).map_err(named)?;
        let mut header = session_header(&config, calibration, &rig_cameras, text).map_err(named)?;
        if let Some((calibration, text)) = &loaded {
            add_calibration(&mut header, calibration, text);
        }
        let silhouette = serde_json::to_value(&config.silhouette).unwrap_or_default();
        let cutting = calibration.map(|calibration| {
            let calibration = RigCalibration {
                volume: header.volume,
                ..calibration.clone()
            };
            Arc::new(SegmentationSettings {
                calibration: calibration.to_toml(),
                silhouette,
            })
        });
        Ok(Prepared {
            config,
            rig_cameras,
            header,
            pool,
            calibration: file,
            cutting,
        })
    }

    /// Where the calibration is, if the rig has one; a relative path is relative to the configuration.
    fn calibration(&self, config: &Config) -> Option<PathBuf> {
        let named = &config.rig.calibration;
        let folder = self.config.parent().unwrap_or(Path::new("."));
        (!named.as_os_str().is_empty()).then(|| folder.join(named))
    }
}

/// Adds to a header which calibration's file it has, and the verdict of the calibration if it has one. The file is told
/// by the SHA-256 of its text, as `sha256sum` prints it, so that it can be found again.
fn add_calibration(header: &mut SessionHeader, calibration: &RigCalibration, text: &str) {
    let sha256 = format!("{:x}", Sha256::digest(text));
    let about = &mut header.about;
    about.insert("calibration_sha256".into(), sha256.clone());
    let verdict = calibration.verdict.clone();
    header.calibration = verdict.map(|verdict| CalibrationRecord {
        verdict,
        file_sha256: Some(sha256),
    });
}

fn unread(what: &str, path: &Path) -> impl FnOnce(std::io::Error) -> Error {
    let what = format!("{what} {}", path.display());
    move |cause| Error::Read { what, cause }
}

/// What every recording begins with.
fn session_header(
    config: &Config,
    calibration: Option<&RigCalibration>,
    rig_cameras: &[RigCamera],
    configuration: String,
) -> Result<SessionHeader, String> {
    let of = |color: bool| {
        let chosen = rig_cameras
            .iter()
            .filter(move |s| (s.kind == CameraKind::Color) == color);
        chosen.filter_map(|s| calibration?.cameras.get(&s.id))
    };
    let depth = |(camera, response): &(Camera, Option<DepthResponse>)| DepthCamera {
        camera: camera.clone(),
        response: response.unwrap_or_default(),
    };
    let volume = config.rig.volume.map(|volume| {
        let volume = Volume::new(volume.min.into(), volume.max.into());
        volume.map_err(|e| format!("rig.volume: {e}"))
    });
    let volume = volume.transpose()?;
    let volume = volume.or_else(|| calibration?.volume);
    if volume.is_none() && calibration.is_some() {
        return Err("rig.volume is missing, and the calibration proposes none".into());
    }
    Ok(SessionHeader {
        colors: of(true).map(|(camera, _)| camera.clone()).collect(),
        depths: of(false).map(depth).collect(),
        volume,
        calibration: None,
        settings: BTreeMap::new(),
        backgrounds: BTreeMap::<CameraId, _>::new(),
        configuration,
        about: BTreeMap::from([("rig".into(), config.rig.name.clone())]),
    })
}
