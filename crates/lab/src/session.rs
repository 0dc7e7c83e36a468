//! A session in front of the simulated rig: the frames that its cameras deliver, when, and with which faults.

use super::burst::{Burst, DEPTH_PERIOD};
use super::check::{check, check_counts, check_faults};
use super::color::expose;
use super::coverage::Layer;
use super::depth::DepthScene;
use super::faults::CaptureFault;
use super::lay::moved;
use super::options::{ColorSensor, Encoding, Faults};
use super::placed::{self, Placed};
use super::random::Random;
use super::render::{Rendered, Subject};
use super::rig::Bounds;
use super::{DepthStation, Error, Options, Rig, SimulatedColorCamera};
use nalgebra::Isometry3;
use rayon::prelude::*;
use scand_core::calibration::Camera;
use scand_core::frame::{CameraId, CaptureId, Frame, Picture, Stream, Timestamp, Trigger};
use scand_core::image::{Grid, Mask, RgbImage};
use scand_core::mesh::Mesh;
use scand_core::reconstruct::{ColorView, DepthFrame, DepthView, Scene, SilhouetteSource};
use std::collections::BTreeMap;
use std::sync::Arc;

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
    /// What stands on the table: in all captures, or in each.
    placed: Vec<Placed>,
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
    pub fn new(mut options: Options) -> Result<Self, Error> {
        if !options.poses.is_empty() {
            options.captures = options.poses.len();
        }
        check(&options)?;
        check_counts(&options)?;
        let object = placed::object(&options);
        let placed = placed::placed(&options, &object)?;
        let truth = moved_to(&object, placed.first());
        let boxes = placed.iter().map(Placed::object_bounds);
        let bounds = boxes.fold(Bounds::of(&truth), |all, one| all.with(&one));
        let rig = Rig::around(&options, &bounds)?;
        check_faults(&options, &rig)?;
        Ok(Self {
            options,
            truth,
            rig,
            placed,
        })
    }

    /// What was asked.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// Where the object was at capture `index`: from its own frame, which is the rig's at the first capture.
    pub fn rig_from_object(&self, index: usize) -> Isometry3<f64> {
        let rig_from_shape = |index| self.placed(index).map(|p| p.rig_from_shape);
        match (rig_from_shape(0), rig_from_shape(index)) {
            (Some(first), Some(here)) if index > 0 => here * first.inverse(),
            _ => Isometry3::identity(),
        }
    }

    /// The object's true surface, in the rig's frame at the first capture.
    pub fn truth(&self) -> &Mesh {
        &self.truth
    }

    /// The cameras and the volume.
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// The exact silhouettes of the first capture, one a colour camera: 255 times the part of each pixel that the
    /// object covers.
    pub fn masks(&self) -> Vec<Mask> {
        self.masks_of(0)
    }

    fn masks_of(&self, index: usize) -> Vec<Mask> {
        let stations = self.rig.colors.par_iter();
        stations.map(|station| self.mask(index, station)).collect()
    }

    /// The exact silhouette that one camera sees in capture `index`.
    pub fn mask(&self, index: usize, station: &SimulatedColorCamera) -> Mask {
        let camera = &station.actual;
        let lens = &camera.intrinsics;
        let layer = self.object(index).and_then(|placed| {
            let mut layer = Layer::new(camera, &placed.mesh)?;
            if let Some(radius) = self.lost(index, camera) {
                layer.lose(camera, radius);
            }
            layer.without_prop(placed.object_triangles);
            Some(layer)
        });
        layer.map_or_else(
            || Mask::filled(lens.width, lens.height, 0),
            |layer| layer.mask(lens.width, lens.height),
        )
    }

    /// The pixels that show a prop to a colour camera in capture `index`, 255 each; `None` where the session says
    /// nothing of props, or there is none.
    pub fn ignored(&self, index: usize, station: &SimulatedColorCamera) -> Option<Mask> {
        let camera = &station.actual;
        let placed = self
            .object(index)
            .filter(|_| self.options.faults.props_ignored)?;
        if placed.object_triangles == placed.mesh.triangles.len() {
            return None;
        }
        let lens = &camera.intrinsics;
        let layer = Layer::new(camera, &placed.mesh);
        Some(layer.map_or_else(
            || Mask::filled(lens.width, lens.height, 0),
            |layer| layer.in_front(placed.object_triangles, lens.width, lens.height),
        ))
    }

    /// Metres of the object that a colour camera does not tell from the backdrop.
    fn lost(&self, index: usize, camera: &Camera) -> Option<f64> {
        let is_first = self.rig.colors.first()?.actual.id == camera.id;
        let lost_mm = CaptureFault::of(&self.options.faults.lost_piece_mm, index)?;
        is_first.then_some(lost_mm * 1e-3)
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
            subject: self.options.subject.clone(),
            placement: self.options.poses.get(index).map(ToString::to_string),
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
            let masks = self.rig.colors.iter().zip(self.masks_of(index));
            silhouettes
                .extend(masks.map(|(s, mask)| (s.actual.id.clone(), SilhouetteSource::Mask(mask))));
        } else {
            let plates = self.backgrounds_with(&sensor).into_iter();
            silhouettes.extend(plates.map(|f| {
                let plate = Arc::new(rgb(&f.picture));
                (f.camera, SilhouetteSource::Background(plate))
            }));
        }
        let view = |station: &SimulatedColorCamera| {
            let frame = frames.iter().find(|f| f.camera == station.actual.id)?;
            Some(ColorView {
                camera: station.calibrated.clone(),
                image: rgb(&frame.picture),
                silhouette: silhouettes.remove(&station.actual.id)?,
                ignored: self.ignored(index, station),
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
        self.bake(index);
        let stations = self.rig.colors.par_iter().enumerate();
        stations
            .filter(|(_, station)| !self.is_missing(&station.actual.id))
            .map(|(k, station)| self.color_frame(k, station, index, sensor))
            .collect()
    }

    fn all_depth_frames(&self, index: usize, sensor: &ColorSensor) -> Vec<Frame> {
        self.bake(index);
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

    /// What stands on the table in capture `index`, whether or not it is empty.
    fn placed(&self, index: usize) -> Option<&Placed> {
        self.placed.get(index).or_else(|| self.placed.first())
    }

    /// The object on the table in capture `index`, if it is there.
    fn object(&self, index: usize) -> Option<&Placed> {
        let is_there = !self.options.faults.empty_table;
        self.placed(index).filter(|_| is_there)
    }

    fn color_frame(
        &self,
        k: usize,
        station: &SimulatedColorCamera,
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
            picture: expose(&self.rendered(index, camera, blur_px), sensor, gains, key),
        }
    }

    /// Bakes the light of capture `index`.
    fn bake(&self, index: usize) {
        if let Some(placed) = self.object(index) {
            placed.bake(self.rays());
        }
    }

    /// Light on a camera's sensor; [`Self::bake`] comes first.
    fn rendered(&self, index: usize, camera: &Camera, blur_px: f64) -> Rendered {
        let Some(placed) = self.object(index) else {
            return Rendered::background(camera);
        };
        let Some(light) = placed.light() else {
            return Rendered::background(camera);
        };
        let subject = Subject {
            mesh: &placed.mesh,
            light,
            material: placed.material,
            object_triangles: placed.object_triangles,
            lost: self.lost(index, camera),
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
        let object = self.object(index).map(|placed| &placed.mesh);
        let scene = DepthScene::new(&self.options, station, object);
        let rendered = self.rendered(index, camera, self.options.color.blur_px);
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

/// The object where the first capture shows it.
fn moved_to(object: &Mesh, first: Option<&Placed>) -> Mesh {
    let pose = first.map_or_else(Isometry3::identity, |p| p.rig_from_shape);
    match pose == Isometry3::identity() {
        true => object.clone(),
        false => moved(object, &pose),
    }
}

pub(super) fn trigger_time(index: usize) -> Timestamp {
    Timestamp(BEGIN + TO_TRIGGER + BETWEEN_TRIGGERS * index as u64)
}

/// A depth camera's frames of a burst, each with the newest colour picture before it.
fn depth_view(station: &DepthStation, burst: &[Frame]) -> DepthView {
    let mut color: Option<Arc<RgbImage>> = None;
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
                    color: color.clone(),
                });
            }
            picture => color = Some(Arc::new(rgb(picture))),
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
