//! Joins captures whose poses are known into one scene, as if all their cameras had stood around the object at once.

use crate::calibration::{Camera, DepthCamera};
use crate::capture::CaptureFacts;
use crate::frame::CameraId;
use crate::reconstruct::hull::Plane;
use crate::reconstruct::silhouette::Silhouette;
use crate::reconstruct::{ColorView, DepthInRigFrame, DepthView, FusedCaptures, Scene};
use nalgebra::{Isometry3, Point3, Vector3};

/// A capture, read.
pub(super) struct Loaded {
    pub(super) scene: Scene,
    pub(super) facts: CaptureFacts,
    pub(super) silhouettes: Vec<Silhouette>,
}

/// A capture's place in a fused scene.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// The number of the capture.
    pub(super) capture: usize,
    /// Maps a point of its rig into the object's frame.
    pub(super) object_from_rig: Isometry3<f64>,
    /// Its rank in painting and carving.
    pub(super) rank: u8,
}

/// Captures as one.
pub(super) struct Merged {
    pub(super) scene: Scene,
    pub(super) silhouettes: Vec<Silhouette>,
    pub(super) standing: FusedCaptures,
    pub(super) facts: CaptureFacts,
}

/// Joins captures at their places. The scene's frame is the rig of capture `frame_of`; `None` if it is none of them.
pub(super) fn merge(captures: Vec<(Place, Loaded)>, frame_of: usize) -> Option<Merged> {
    let (_, frame) = captures.iter().find(|(p, _)| p.capture == frame_of)?;
    let mut merged = Merged {
        scene: Scene {
            colors: Vec::new(),
            depths: Vec::new(),
            volume: frame.scene.volume,
        },
        silhouettes: Vec::new(),
        standing: FusedCaptures {
            table_captures: vec![frame_of as u16],
            ..FusedCaptures::default()
        },
        facts: CaptureFacts {
            colors: Vec::new(),
            depths: Vec::new(),
            left_out: Vec::new(),
            warnings: Vec::new(),
            damage: Vec::new(),
            ..frame.facts.clone()
        },
    };
    let (mut depth_ranks, mut depth_captures) = (Vec::new(), Vec::new());
    for (place, capture) in captures {
        depth_ranks.extend(capture.scene.depths.iter().map(|_| place.rank));
        depth_captures.extend(capture.scene.depths.iter().map(|_| place.capture as u16));
        let is_frame = place.capture == frame_of;
        merged.add(capture, &place, (!is_frame).then_some(place.capture + 1));
    }
    let Merged {
        scene, standing, ..
    } = &mut merged;
    debug_assert_eq!(standing.ranks.len(), scene.colors.len());
    standing.ranks.extend(depth_ranks);
    standing.captures.extend(depth_captures);
    Some(merged)
}

impl Merged {
    /// Adds a capture. Cameras of one that does not give the frame bear its number in their names.
    fn add(&mut self, capture: Loaded, place: &Place, number: Option<usize>) {
        let Loaded {
            scene,
            facts,
            silhouettes,
        } = capture;
        let pose = place.object_from_rig;
        let renamed = |id: &CameraId| number.map_or_else(|| id.clone(), |n| with_number(id, n));
        if number.is_some() {
            let floor = Point3::new(0.0, 0.0, scene.volume.min.z);
            self.standing.tables.push(Plane {
                point: pose * floor,
                normal: pose.rotation * Vector3::z(),
            });
            self.standing.table_captures.push(place.capture as u16);
        }
        for view in scene.colors {
            let camera = moved(&view.camera, &pose, renamed(&view.camera.id), number);
            self.scene.colors.push(ColorView { camera, ..view });
            self.standing.ranks.push(place.rank);
            self.standing.captures.push(place.capture as u16);
        }
        for view in scene.depths {
            let id = renamed(&view.camera.camera.id);
            let camera = DepthCamera {
                camera: moved(&view.camera.camera, &pose, id, number),
                response: view.camera.response,
            };
            self.standing.depths.push(DepthInRigFrame {
                view: view.clone(),
                volume: scene.volume,
                scene_from_rig: pose,
                capture: place.capture,
                rank: place.rank,
            });
            self.scene.depths.push(DepthView { camera, ..view });
        }
        self.silhouettes.extend(silhouettes);
        self.add_facts(facts, renamed);
    }

    fn add_facts(&mut self, facts: CaptureFacts, renamed: impl Fn(&CameraId) -> CameraId) {
        let into = &mut self.facts;
        into.skew_ns = into.skew_ns.max(facts.skew_ns);
        into.colors.extend(facts.colors.into_iter().map(|mut c| {
            c.camera = renamed(&c.camera);
            c
        }));
        into.depths.extend(facts.depths.into_iter().map(|mut d| {
            d.camera = renamed(&d.camera);
            d
        }));
        into.left_out
            .extend(facts.left_out.into_iter().map(|mut l| {
                l.camera = renamed(&l.camera);
                l
            }));
        for warning in facts.warnings {
            if !into.warnings.contains(&warning) {
                into.warnings.push(warning);
            }
        }
        into.damage.extend(facts.damage);
        // A fused model is no better than the worst calibration of its captures.
        let is_worse = match (&into.calibration, &facts.calibration) {
            (_, None) => false,
            (None, Some(_)) => true,
            (Some(known), Some(other)) => other.level > known.level,
        };
        if is_worse {
            into.calibration = facts.calibration;
        }
    }
}

/// A camera in the object's frame; as it is where that is its own rig's.
fn moved(
    camera: &Camera,
    object_from_rig: &Isometry3<f64>,
    id: CameraId,
    number: Option<usize>,
) -> Camera {
    if number.is_none() {
        return camera.clone();
    }
    Camera::new(
        id,
        camera.intrinsics,
        object_from_rig * camera.rig_from_camera,
    )
}

/// A camera's name with the number of its capture.
fn with_number(id: &CameraId, number: usize) -> CameraId {
    let ending = format!("_{number}");
    let room = 32 - ending.len();
    let begin = &id.as_str()[..id.as_str().len().min(room)];
    CameraId::new(&format!("{begin}{ending}")).unwrap_or_else(|_| id.clone())
}
