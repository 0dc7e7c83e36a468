//! Joins captures whose poses are known into one scene, as if all their cameras had stood around the object at once.

use crate::calibration::{Camera, DepthCamera};
use crate::capture::CaptureFacts;
use crate::frame::CameraId;
use crate::reconstruct::hull::Plane;
use crate::reconstruct::silhouette::Silhouette;
use crate::reconstruct::{ColorView, DepthInRigFrame, DepthView, FusedCaptures, Scene};
use nalgebra::{Isometry3, Point3, Vector3};
use std::collections::{BTreeMap, BTreeSet};

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
    let mut taken: BTreeSet<CameraId> = names(frame).cloned().collect();
    let (mut depth_ranks, mut depth_captures) = (Vec::new(), Vec::new());
    for (place, capture) in captures {
        depth_ranks.extend(capture.scene.depths.iter().map(|_| place.rank));
        depth_captures.extend(capture.scene.depths.iter().map(|_| place.capture as u16));
        let is_frame = place.capture == frame_of;
        let renamed = (!is_frame).then(|| numbered(&capture, place.capture + 1, &mut taken));
        merged.add(capture, &place, renamed.as_ref());
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
    /// Adds a capture. `names` has the names of its cameras in the scene, if it does not give the frame.
    fn add(
        &mut self,
        capture: Loaded,
        place: &Place,
        names: Option<&BTreeMap<CameraId, CameraId>>,
    ) {
        let Loaded {
            scene,
            facts,
            silhouettes,
        } = capture;
        let pose = place.object_from_rig;
        let renamed = |id: &CameraId| names.and_then(|names| names.get(id)).unwrap_or(id).clone();
        let is_frame = names.is_none();
        if !is_frame {
            let floor = Point3::new(0.0, 0.0, scene.volume.min.z);
            self.standing.tables.push(Plane {
                point: pose * floor,
                normal: pose.rotation * Vector3::z(),
            });
            self.standing.table_captures.push(place.capture as u16);
        }
        for view in scene.colors {
            let camera = moved(&view.camera, &pose, renamed(&view.camera.id), is_frame);
            self.scene.colors.push(ColorView { camera, ..view });
            self.standing.ranks.push(place.rank);
            self.standing.captures.push(place.capture as u16);
        }
        for view in scene.depths {
            let id = renamed(&view.camera.camera.id);
            let camera = DepthCamera {
                camera: moved(&view.camera.camera, &pose, id, is_frame),
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
        // Each capture of a recording tells all that is known of the recording.
        extend_by_new(&mut into.warnings, facts.warnings);
        extend_by_new(&mut into.damage, facts.damage);
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

/// Adds what is not there yet.
fn extend_by_new<T: PartialEq>(known: &mut Vec<T>, more: Vec<T>) {
    for one in more {
        if !known.contains(&one) {
            known.push(one);
        }
    }
}

/// A camera in the object's frame; as it is where that is its own rig's.
fn moved(
    camera: &Camera,
    object_from_rig: &Isometry3<f64>,
    id: CameraId,
    is_frame: bool,
) -> Camera {
    if is_frame {
        return camera.clone();
    }
    Camera::new(
        id,
        camera.intrinsics,
        object_from_rig * camera.rig_from_camera,
    )
}

/// The names of all cameras of a capture, some several times.
fn names(capture: &Loaded) -> impl Iterator<Item = &CameraId> {
    let Loaded { scene, facts, .. } = capture;
    let colors = scene.colors.iter().map(|view| &view.camera.id);
    let depths = scene.depths.iter().map(|view| &view.camera.camera.id);
    let colors = colors.chain(facts.colors.iter().map(|facts| &facts.camera));
    let depths = depths.chain(facts.depths.iter().map(|facts| &facts.camera));
    let left_out = facts.left_out.iter().map(|left_out| &left_out.camera);
    colors.chain(depths).chain(left_out)
}

/// For each camera of a capture its name with the capture's number, which is none of those that are `taken`, and is
/// taken from then on.
fn numbered(
    capture: &Loaded,
    number: usize,
    taken: &mut BTreeSet<CameraId>,
) -> BTreeMap<CameraId, CameraId> {
    let own: BTreeSet<&CameraId> = names(capture).collect();
    let mut renamed = BTreeMap::new();
    for id in own {
        let name = with_number(id, number, taken);
        taken.insert(name.clone());
        renamed.insert(id.clone(), name);
    }
    renamed
}

/// A camera's name with the number of its capture. A long name is cut; where another camera then has the same, it also
/// gets a number of its own.
fn with_number(id: &CameraId, number: usize, taken: &BTreeSet<CameraId>) -> CameraId {
    // One of so many different names is free.
    let endings = (1..=taken.len() + 1).map(|own| match own {
        1 => format!("_{number}"),
        _ => format!("_{own}_{number}"),
    });
    let mut names = endings.map(|ending| with_ending(id, &ending));
    let free = names.find(|name| !taken.contains(name));
    free.unwrap_or_else(|| id.clone())
}

fn with_ending(id: &CameraId, ending: &str) -> CameraId {
    let room = 32_usize.saturating_sub(ending.len());
    let begin = &id.as_str()[..id.as_str().len().min(room)];
    CameraId::new(&format!("{begin}{ending}")).unwrap_or_else(|_| id.clone())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{
        CalibrationLevel, CalibrationVerdict, DepthResponse, Distortion, Intrinsics, Volume,
    };
    use crate::frame::{CaptureId, Timestamp};
    use crate::image::{Mask, RgbImage};
    use crate::reconstruct::SilhouetteSource;
    use crate::recording::Damage;
    use nalgebra::Vector2;

    /// A capture of one colour camera and one depth camera, whose table lies 10 mm below the rig's origin.
    fn loaded(id: &str, level: Option<CalibrationLevel>) -> Loaded {
        let camera = |name: &str, height: f64| {
            let (focal, center) = (Vector2::repeat(40.0), Vector2::repeat(16.0));
            let lens = Intrinsics::new(32, 32, focal, center, Distortion::default());
            let pose = Isometry3::translation(0.0, 0.0, height);
            Camera::new(CameraId::new(name).unwrap(), lens.unwrap(), pose)
        };
        let calibration = level.map(|level| CalibrationVerdict {
            level,
            reasons: Vec::new(),
        });
        let facts = CaptureFacts {
            id: CaptureId::new(id).unwrap(),
            time_ns: Timestamp(1),
            source: "test".into(),
            subject: None,
            placement: None,
            skew_ns: 0,
            colors: Vec::new(),
            depths: Vec::new(),
            calibration,
            left_out: Vec::new(),
            warnings: vec!["the lens is dusty".into()],
            damage: vec![Damage {
                offset: 9,
                length: 3,
                what: "the CRC is wrong".into(),
            }],
        };
        let color = ColorView {
            camera: camera("left", -0.5),
            image: RgbImage::filled(32, 32, [120; 3]),
            silhouette: SilhouetteSource::Mask(Mask::filled(32, 32, 255)),
            ignored: None,
        };
        let depth = DepthView {
            camera: DepthCamera {
                camera: camera("kinect", -0.8),
                response: DepthResponse::default(),
            },
            frames: Vec::new(),
        };
        let corner = |xy: f64, z: f64| Point3::new(xy, xy, z);
        Loaded {
            scene: Scene {
                colors: vec![color],
                depths: vec![depth],
                volume: Volume::new(corner(-0.1, -0.01), corner(0.1, 0.2)).unwrap(),
            },
            facts,
            silhouettes: Vec::new(),
        }
    }

    fn place(capture: usize, rank: u8) -> Place {
        // The object was lifted by 100 mm a capture, as the first one's rig sees it.
        Place {
            capture,
            object_from_rig: Isometry3::translation(0.0, 0.0, -0.1 * capture as f64),
            rank,
        }
    }

    #[test]
    fn cameras_and_tables_stand_around_the_object_and_names_say_whose_they_are() {
        let captures = vec![
            (place(0, 0), loaded("a", None)),
            (place(2, 1), loaded("c", None)),
        ];
        let merged = merge(captures, 0).unwrap();
        let colors = &merged.scene.colors;
        let ids: Vec<&str> = colors.iter().map(|v| v.camera.id.as_str()).collect();
        assert_eq!(ids, ["left", "left_3"]);
        let heights: Vec<f64> = colors.iter().map(|v| v.camera.center().z).collect();
        assert!((heights[0] + 0.5).abs() < 1e-9 && (heights[1] + 0.7).abs() < 1e-9);
        let depth = &merged.scene.depths[1].camera.camera;
        assert_eq!(depth.id.as_str(), "kinect_3");
        assert!((depth.center().z + 1.0).abs() < 1e-9);
        // In its own rig, the depth camera is where it was.
        let standing = &merged.standing;
        let own = &standing.depths[1].view.camera.camera;
        assert!((own.center().z + 0.8).abs() < 1e-9 && own.id.as_str() == "kinect");
        assert_eq!(
            (standing.depths[1].capture, standing.depths[1].rank),
            (2, 1)
        );
        // The table of the capture that gives the frame is the volume's floor; the other's bounds the object, too.
        assert_eq!(standing.table_captures, [0, 2]);
        let [table] = &standing.tables[..] else {
            panic!("{:?}", standing.tables);
        };
        assert!((table.point.z + 0.21).abs() < 1e-9 && table.normal == Vector3::z());
        // Colour views, then depth views.
        assert_eq!(standing.captures, [0, 2, 0, 2]);
        assert_eq!(standing.ranks, [0, 1, 0, 1]);
        // What is said of both is said once.
        assert_eq!(merged.facts.warnings, ["the lens is dusty"]);
        assert_eq!(merged.facts.damage.len(), 1);
        assert!(merge(vec![(place(0, 0), loaded("a", None))], 1).is_none());
    }

    #[test]
    fn the_worst_calibration_of_the_captures_is_that_of_the_model() {
        use CalibrationLevel::{Doubtful, Good};
        let merged = |levels: [Option<CalibrationLevel>; 2]| {
            let captures = levels.into_iter().enumerate();
            let captures = captures.map(|(i, level)| (place(i, 0), loaded("a", level)));
            let merged = merge(captures.collect(), 0).unwrap();
            merged.facts.calibration.map(|verdict| verdict.level)
        };
        assert_eq!(merged([Some(Good), Some(Doubtful)]), Some(Doubtful));
        assert_eq!(merged([Some(Doubtful), Some(Good)]), Some(Doubtful));
        assert_eq!(merged([None, Some(Doubtful)]), Some(Doubtful));
        assert_eq!(merged([Some(Good), None]), Some(Good));
        assert_eq!(merged([None, None]), None);
    }

    #[test]
    fn a_long_name_keeps_the_number_of_its_capture() {
        let long = CameraId::new(&"x".repeat(32)).unwrap();
        let named = with_number(&long, 12, &BTreeSet::new());
        assert_eq!(named.as_str(), "x".repeat(29) + "_12");
    }

    #[test]
    fn cameras_whose_long_names_begin_alike_stay_two() {
        let renamed = |capture: Loaded, ids: [&str; 2]| {
            let mut capture = capture;
            let view = capture.scene.colors.remove(0);
            let named = |name: &str| {
                let id = CameraId::new(name).unwrap();
                let camera = Camera::new(id, view.camera.intrinsics, view.camera.rig_from_camera);
                ColorView {
                    camera,
                    ..view.clone()
                }
            };
            capture.scene.colors = ids.map(named).into();
            capture
        };
        let begin = "x".repeat(31);
        let [a, b] = ["a", "b"].map(|end| format!("{begin}{end}"));
        // The second name of the first capture is what the third capture's name is cut to.
        let cut = format!("{}_3", "x".repeat(30));
        let captures = vec![
            (place(2, 1), renamed(loaded("c", None), [&a, &b])),
            (place(0, 0), renamed(loaded("a", None), [&a, &cut])),
        ];
        let merged = merge(captures, 0).unwrap();
        let colors = &merged.scene.colors;
        let ids: Vec<&str> = colors.iter().map(|view| view.camera.id.as_str()).collect();
        let twice = "x".repeat(28);
        let [second, third] = [2, 3].map(|own| format!("{twice}_{own}_3"));
        assert_eq!(ids, [&second, &third, &a, &cut]);
    }
}
