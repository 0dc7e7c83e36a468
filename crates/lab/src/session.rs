//! A session in front of the simulated rig: the frames that its cameras deliver, when, and with which faults.

use super::burst::{Burst, DEPTH_PERIOD};
use super::color::expose;
use super::coverage::Layer;
use super::depth::DepthScene;
use super::light::Light;
use super::material::Material;
use super::options::{ColorSensor, Encoding, Faults};
use super::random::Random;
use super::render::{Rendered, Subject};
use super::{ColorStation, DepthStation, Error, Options, Rig, invalid, within_range};
use rayon::prelude::*;
use scand_core::calibration::Camera;
use scand_core::frame::{CameraId, CaptureId, Frame, Picture, Stream, Timestamp, Trigger};
use scand_core::image::{Grid, Mask, RgbImage};
use scand_core::mesh::Mesh;
use scand_core::reconstruct::{ColorView, DepthFrame, DepthView, Scene, SilhouetteSource};
use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

/// When sessions begin, in UTC nanoseconds.
pub(super) const BEGIN: u64 = 1_767_225_600_000_000_000;
/// Nanoseconds from the session's begin to the backgrounds, to the first trigger, between triggers.
const TO_BACKGROUND: u64 = 1_000_000_000;
const TO_TRIGGER: u64 = 5_000_000_000;
const BETWEEN_TRIGGERS: u64 = 10_000_000_000;

/// An object among cameras, ready to be looked at.
#[derive(Debug)]
pub struct Simulation {
    options: Options,
    truth: Mesh,
    rig: Rig,
    light: OnceLock<Light>,
}

/// What the rig hands over for one trigger.
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    /// The trigger.
    pub trigger: Trigger,
    /// The frames, in the order of their timestamps.
    pub frames: Vec<Frame>,
}

impl Simulation {
    /// Makes the object and sets up the rig around it. Nothing is rendered yet.
    ///
    /// # Errors
    /// If an option cannot be met.
    pub fn new(options: Options) -> Result<Self, Error> {
        check(&options)?;
        check_counts(&options)?;
        let truth = options.shape.mesh(options.spacing_mm * 1e-3);
        let rig = Rig::new(&options, &truth)?;
        check_faults(&options, &rig)?;
        Ok(Self {
            options,
            truth,
            rig,
            light: OnceLock::new(),
        })
    }

    /// What was asked.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// The object's true surface.
    pub fn truth(&self) -> &Mesh {
        &self.truth
    }

    /// The cameras and the volume.
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// The exact silhouettes, one a colour camera: 255 times the part of each pixel that the object covers.
    pub fn masks(&self) -> Vec<Mask> {
        self.rig
            .colors
            .par_iter()
            .map(|station| self.mask(station))
            .collect()
    }

    /// The exact silhouette that one camera sees.
    pub fn mask(&self, station: &ColorStation) -> Mask {
        let lens = &station.actual.intrinsics;
        let layer = self
            .object()
            .and_then(|mesh| Layer::new(&station.actual, mesh));
        layer.map_or_else(
            || Mask::filled(lens.width, lens.height, 0),
            |layer| layer.mask(lens.width, lens.height),
        )
    }

    /// The exact depth of the object in metres along the optical axis at each pixel of depth camera
    /// `index`, as it is calibrated; infinite where the object is not.
    #[cfg(test)]
    pub(crate) fn exact_depth(&self, index: usize) -> Grid<f32> {
        let station = &self.rig.depths[index].calibrated;
        let lens = &station.camera.intrinsics;
        let mut depth = Grid::filled(lens.width, lens.height, f32::INFINITY);
        let project = |p| {
            let p = station.camera.camera_from_rig(p);
            let pixel = station.response.project(lens, p)?;
            Some([pixel.x, pixel.y, p.z])
        };
        if let Some(layer) = Layer::with(&self.truth, project, lens.width, lens.height) {
            let [x0, y0] = layer.origin;
            for y in 0..layer.fragments.height() {
                for (x, fragment) in layer.fragments.row(y).iter().enumerate() {
                    depth[(x0 + x, y0 + y)] = fragment.depth;
                }
            }
        }
        depth
    }

    /// When the session begins; its calibration is as old.
    pub fn begin(&self) -> Timestamp {
        Timestamp(BEGIN)
    }

    /// The backgrounds, one a colour camera that has one.
    pub fn backgrounds(&self) -> Vec<Frame> {
        self.backgrounds_with(&self.options.color)
    }

    fn backgrounds_with(&self, sensor: &ColorSensor) -> Vec<Frame> {
        let faults = &self.options.faults;
        let stations = self.rig.colors.par_iter().enumerate();
        let plates = stations.filter(|(_, s)| {
            let id = s.actual.id.as_str();
            !faults.no_background.iter().any(|name| name == id)
        });
        plates
            .map(|(index, station)| {
                let camera = &station.actual;
                let rendered = Rendered::background(camera);
                let key = [self.options.seed, 3, index as u64, 0];
                Frame {
                    camera: camera.id.clone(),
                    stream: Stream::Color,
                    timestamp: Timestamp(BEGIN + TO_BACKGROUND),
                    picture: expose(&rendered, sensor, [1.0; 3], key),
                }
            })
            .collect()
    }

    /// Capture `index` of the session.
    ///
    /// # Errors
    /// Never fails for a valid index.
    pub fn capture(&self, index: usize) -> Result<Capture, Error> {
        let shape = clap::ValueEnum::to_possible_value(&self.options.shape);
        let name = shape.map_or_else(String::new, |s| s.get_name().to_owned());
        let trigger = Trigger {
            id: CaptureId::new(&format!("{name}-{index:03}"))?,
            time: trigger_time(index),
            source: "simulation".to_owned(),
            press_id: None,
            subject: None,
        };
        let sensors = (&self.options.color, &depth_color(&self.options));
        let mut frames = self.color_frames(index, sensors.0);
        frames.extend(self.all_depth_frames(index, sensors.1));
        frames.sort_by(|a, b| {
            let order = |f: &Frame| (f.timestamp, f.stream);
            order(a)
                .cmp(&order(b))
                .then_with(|| a.camera.cmp(&b.camera))
        });
        Ok(Capture { trigger, frames })
    }

    /// Capture `index` as a reconstruction takes it: developed and decoded, with nothing lost to an encoding
    /// and no file in between. With [`Options::masks`] it has the exact silhouettes. A camera that is missing
    /// or has no background is left out.
    pub fn scene(&self, index: usize) -> Scene {
        let plain = |sensor: ColorSensor| ColorSensor {
            encoding: Encoding::Rgb,
            ..sensor
        };
        let sensor = plain(self.options.color.clone());
        let frames = self.color_frames(index, &sensor);
        let mut silhouettes: BTreeMap<CameraId, SilhouetteSource> = BTreeMap::new();
        if self.options.masks {
            let masks = self.rig.colors.iter().zip(self.masks());
            silhouettes
                .extend(masks.map(|(s, mask)| (s.actual.id.clone(), SilhouetteSource::Mask(mask))));
        } else {
            let plates = self.backgrounds_with(&sensor).into_iter();
            silhouettes.extend(plates.map(|f| {
                let plate = Arc::new(rgb(&f.picture));
                (f.camera, SilhouetteSource::Background(plate))
            }));
        }
        let view = |station: &ColorStation| {
            let frame = frames.iter().find(|f| f.camera == station.actual.id)?;
            Some(ColorView {
                camera: station.calibrated.clone(),
                image: rgb(&frame.picture),
                silhouette: silhouettes.remove(&station.actual.id)?,
            })
        };
        let colors = self.rig.colors.iter().filter_map(view).collect();
        let burst = self.all_depth_frames(index, &plain(depth_color(&self.options)));
        let stations = self.rig.depths.iter();
        let depths = stations
            .filter(|station| !self.is_missing(&station.actual.camera.id))
            .map(|station| depth_view(station, &burst));
        Scene {
            colors,
            depths: depths.collect(),
            volume: self.rig.volume,
        }
    }

    fn color_frames(&self, index: usize, sensor: &ColorSensor) -> Vec<Frame> {
        self.bake();
        let stations = self.rig.colors.par_iter().enumerate();
        stations
            .filter(|(_, station)| !self.is_missing(&station.actual.id))
            .map(|(k, station)| self.color_frame(k, station, index, sensor))
            .collect()
    }

    fn all_depth_frames(&self, index: usize, sensor: &ColorSensor) -> Vec<Frame> {
        self.bake();
        let stations = self.rig.depths.iter().enumerate();
        stations
            .filter(|(_, station)| !self.is_missing(&station.actual.camera.id))
            .flat_map(|(k, station)| self.depth_frames(k, station, index, sensor))
            .collect()
    }

    fn is_missing(&self, id: &CameraId) -> bool {
        let missing = &self.options.faults.missing;
        missing.iter().any(|name| name == id.as_str())
    }

    /// The object on the table, if it is there.
    fn object(&self) -> Option<&Mesh> {
        (!self.options.faults.empty_table).then_some(&self.truth)
    }

    fn color_frame(
        &self,
        k: usize,
        station: &ColorStation,
        index: usize,
        sensor: &ColorSensor,
    ) -> Frame {
        let Options {
            seed,
            color,
            faults,
            ..
        } = &self.options;
        let camera = &station.actual;
        let id = camera.id.as_str();
        let mut random = Random::new(&[*seed, 4, k as u64, index as u64]);
        let delay = random.between(2e5, 3e6) as u64 + faults.late_ns(id);
        let stops = Faults::amount(&faults.overexposed_stops, id);
        let exposure = (1.0 + color.exposure_drift * random.normal()) * stops.exp2();
        let gains = [0; 3]
            .map(|_| (exposure * (1.0 + color.exposure_drift / 3.0 * random.normal())) as f32);
        let blur_px = color.blur_px.hypot(Faults::amount(&faults.blurred_px, id));
        let key = [*seed, 3, k as u64, index as u64 + 1];
        Frame {
            camera: camera.id.clone(),
            stream: Stream::Color,
            timestamp: Timestamp(trigger_time(index).0 + delay),
            picture: expose(&self.rendered(camera, blur_px), sensor, gains, key),
        }
    }

    /// Bakes the light, once. Baking works in parallel and may meet itself on one thread, so nobody waits
    /// for anybody: at worst two do the same work.
    fn bake(&self) {
        if let (None, Some(mesh)) = (self.light.get(), self.object()) {
            let _ = self.light.set(Light::bake(mesh, self.rays()));
        }
    }

    /// Light on a camera's sensor; [`Self::bake`] comes first.
    fn rendered(&self, camera: &Camera, blur_px: f64) -> Rendered {
        let (Some(mesh), Some(light)) = (self.object(), self.light.get()) else {
            return Rendered::background(camera);
        };
        let subject = Subject {
            mesh,
            light,
            material: Material::new(self.options.shape, self.options.seed, self.options.textured),
            shadows: self.options.color.shadows as f32,
            spill: self.options.color.spill as f32,
        };
        Rendered::with_object(camera, &subject, blur_px)
    }

    /// Rays a vertex for its light: fewer where the picture is too small to show the difference.
    fn rays(&self) -> usize {
        if self.options.width >= 1000 { 72 } else { 24 }
    }

    /// A burst of depth frames with their colour pictures.
    fn depth_frames(
        &self,
        k: usize,
        station: &DepthStation,
        index: usize,
        sensor: &ColorSensor,
    ) -> Vec<Frame> {
        let seed = self.options.seed;
        let camera = &station.actual.camera;
        let mut random = Random::new(&[seed, 8, k as u64, index as u64]);
        let start = trigger_time(index).0
            + (random.uniform() * DEPTH_PERIOD as f64) as u64
            + self.options.faults.late_ns(camera.id.as_str());
        let scene = DepthScene::new(&self.options, station, self.object());
        let rendered = self.rendered(camera, self.options.color.blur_px);
        Burst {
            options: &self.options,
            station,
            camera: k as u64,
            scene: &scene,
            rendered: &rendered,
            sensor,
            capture: index,
            start,
            noise: 9,
        }
        .frames()
    }
}

/// Refuses numbers that make no session.
pub(super) fn check(options: &Options) -> Result<(), Error> {
    let (color, depth) = (&options.color, &options.depth);
    let within = [
        ("spacing", options.spacing_mm, [0.1, 50.0], " mm"),
        (
            "depth slant",
            options.depth_slant_deg,
            [0.0, 50.0],
            " degrees",
        ),
        ("depth distance", options.depth_distance, [0.4, 3.0], " m"),
        ("JPEG quality", color.jpeg_quality.into(), [1.0, 100.0], ""),
        (
            "JPEG quality of the depth camera's colour",
            depth.color_jpeg_quality.into(),
            [0.0, 100.0],
            " (0 is rgb8)",
        ),
        ("full well", color.full_well, [0.0, 1e9], " electrons"),
        ("read noise", color.read_noise, [0.0, 1e6], " electrons"),
        ("blur", color.blur_px, [0.0, 4.0], " px"),
        ("exposure drift", color.exposure_drift, [0.0, 0.3], ""),
        ("shadows", color.shadows, [0.0, 1.0], ""),
        ("spill", color.spill, [0.0, 1.0], ""),
        ("depth smear", depth.smear_px, [0.0, 9.0], " px"),
        ("depth bias", depth.bias_mm, [-200.0, 200.0], " mm"),
        (
            "misregistration",
            depth.misregistration_px,
            [-50.0, 50.0],
            " px",
        ),
    ];
    for (what, found, range, unit) in within {
        within_range(what, found, range, unit)?;
    }
    Ok(())
}

/// Refuses a session that no model can be made of.
fn check_counts(options: &Options) -> Result<(), Error> {
    if options.cameras < 2 {
        return Err(invalid("cameras", options.cameras, "2 to 99"));
    }
    if options.captures == 0 {
        return Err(invalid("captures", options.captures, "at least 1"));
    }
    Ok(())
}

/// Refuses faults of cameras that are not there, or that cannot have them.
pub(super) fn check_faults(options: &Options, rig: &Rig) -> Result<(), Error> {
    let colors = rig.colors.iter().map(|s| s.actual.id.as_str());
    let depths = rig.depths.iter().map(|s| s.actual.camera.id.as_str());
    let depths: Vec<&str> = depths.collect();
    let known: Vec<&str> = colors.chain(depths.iter().copied()).collect();
    let faults = &options.faults;
    if let Some(name) = faults.cameras().find(|name| !known.contains(name)) {
        let expected = "the id of a camera of the rig";
        return Err(invalid("camera of a fault", name, expected));
    }
    let no_background = faults.no_background.iter().map(String::as_str);
    let without = no_background.map(|camera| ("camera without a background", camera));
    let of_colors = faults.of_colors().into_iter();
    let named = of_colors.flat_map(|(what, list)| list.iter().map(move |f| (what, &*f.camera)));
    match named
        .chain(without)
        .find(|(_, camera)| depths.contains(camera))
    {
        Some((what, camera)) => Err(invalid(
            what,
            format!("the depth camera {camera}"),
            "a colour camera: a depth camera may be missing or late",
        )),
        None => Ok(()),
    }
}

pub(super) fn trigger_time(index: usize) -> Timestamp {
    Timestamp(BEGIN + TO_TRIGGER + BETWEEN_TRIGGERS * index as u64)
}

/// What a depth camera gave to a burst, each reading with the newest colour picture before it.
fn depth_view(station: &DepthStation, burst: &[Frame]) -> DepthView {
    let mut color = Arc::new(RgbImage::default());
    let mut frames = Vec::new();
    for frame in burst
        .iter()
        .filter(|f| f.camera == station.actual.camera.id)
    {
        match &frame.picture {
            Picture::Raw {
                width,
                height,
                data,
                ..
            } if frame.stream == Stream::Depth => {
                let (pairs, _) = data.as_chunks::<2>();
                let readings = pairs.iter().map(|&b| u16::from_le_bytes(b)).collect();
                frames.push(DepthFrame {
                    readings: Grid::from_pixels(*width as usize, *height as usize, readings),
                    color: Arc::clone(&color),
                });
            }
            picture => color = Arc::new(rgb(picture)),
        }
    }
    DepthView {
        camera: station.calibrated.clone(),
        frames,
    }
}

/// The pixels of a picture that was developed as `rgb8`.
fn rgb(picture: &Picture) -> RgbImage {
    match picture {
        Picture::Raw {
            width,
            height,
            data,
            ..
        } => {
            let pixels = data.as_chunks::<3>().0.to_vec();
            Grid::from_pixels(*width as usize, *height as usize, pixels)
        }
        Picture::Compressed { .. } => RgbImage::default(),
    }
}

/// The depth camera's own colour sensor: small, with more noise.
pub(super) fn depth_color(options: &Options) -> ColorSensor {
    let quality = options.depth.color_jpeg_quality;
    ColorSensor {
        encoding: if quality == 0 {
            Encoding::Rgb
        } else {
            Encoding::Jpeg
        },
        jpeg_quality: quality,
        full_well: options.color.full_well * 0.4,
        ..options.color.clone()
    }
}
