//! A rig without pictures, for tests: cameras around a table, a board at many places, and corners with noise.

use super::session::{Corner, Session, SessionCamera, View};
use crate::calibration::{Board, BoardShape, Camera, Distortion, Face, Intrinsics, Surface};
use crate::frame::CameraId;
use nalgebra::{
    Isometry3, Point2, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3,
};

/// Numbers that only look random (SplitMix64).
pub(super) struct Random(pub u64);

impl Random {
    pub(super) fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) as f64 / u64::MAX as f64
    }

    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    pub(super) fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform().max(1e-12).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// The truth that a test holds a fit against.
pub(super) struct Truth {
    pub cameras: Vec<Camera>,
    /// From the board's frame to the rig's.
    pub placements: Vec<Isometry3<f64>>,
    pub board: Board,
    pub front_from_back: Isometry3<f64>,
    pub shape: BoardShape,
}

/// A camera at `from` that looks at `at`.
pub(super) fn looking(name: &str, lens: Intrinsics, from: Point3<f64>, at: Point3<f64>) -> Camera {
    let z = (at - from).normalize();
    let x = Vector3::z()
        .cross(&-z)
        .try_normalize(1e-6)
        .unwrap_or(Vector3::x());
    let rotation = Rotation3::from_basis_unchecked(&[-x, z.cross(&-x), z]);
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    let pose = Isometry3::from_parts(Translation3::from(from.coords), rotation);
    Camera::new(CameraId::new(name).unwrap(), lens, pose)
}

pub(super) fn color_lens() -> Intrinsics {
    let distortion = Distortion {
        radial: [-0.11, 0.08, -0.01, 0.0, 0.0, 0.0],
        tangential: [5e-4, -3e-4],
    };
    let (focal, center) = (Vector2::new(2510.0, 2512.0), Vector2::new(1221.0, 1019.0));
    Intrinsics::new(2448, 2048, focal, center, distortion).unwrap()
}

fn depth_lens() -> Intrinsics {
    let distortion = Distortion {
        radial: [0.05, -0.1, 0.0, 0.0, 0.0, 0.0],
        tangential: [0.0, 0.0],
    };
    let (focal, center) = (Vector2::new(575.8, 576.3), Vector2::new(318.0, 241.0));
    Intrinsics::new(640, 480, focal, center, distortion).unwrap()
}

/// Eleven colour cameras of 5 MP at two heights around a table, and a depth camera above it.
pub(super) fn rig() -> Vec<Camera> {
    let middle = Point3::new(0.0, 0.0, 0.08);
    let mut cameras: Vec<Camera> = (0..11)
        .map(|i| {
            let angle = i as f64 / 11.0 * std::f64::consts::TAU;
            let height = if i % 2 == 0 { 0.45 } else { 0.85 };
            let from = Point3::new(0.75 * angle.cos(), 0.75 * angle.sin(), height);
            looking(&format!("c{i:02}"), color_lens(), from, middle)
        })
        .collect();
    cameras.push(looking(
        "kinect",
        depth_lens(),
        Point3::new(0.05, -0.2, 1.0),
        middle,
    ));
    cameras
}

/// A board whose front's middle is at `middle`, facing up, then tilted and turned.
pub(super) fn placed(
    board: &Board,
    middle: Point3<f64>,
    tilt: Vector3<f64>,
    turn: f64,
) -> Isometry3<f64> {
    let width = (board.columns - 1) as f64 * board.square;
    let height = (board.rows - 1) as f64 * board.square;
    let up = UnitQuaternion::from_scaled_axis(Vector3::x() * std::f64::consts::PI);
    let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * turn);
    let rotation = UnitQuaternion::from_scaled_axis(tilt) * turn * up;
    let shift = middle.coords - rotation * Vector3::new(width / 2.0, height / 2.0, 0.0);
    Isometry3::from_parts(Translation3::from(shift), rotation)
}

/// Placements over a table: the first flat on it, the others tilted up to 45° to all sides.
pub(super) fn placements(board: &Board, count: usize, random: &mut Random) -> Vec<Isometry3<f64>> {
    (0..count)
        .map(|i| {
            if i == 0 {
                return placed(board, Point3::new(0.01, 0.02, 0.0), Vector3::zeros(), 0.3);
            }
            let to = i as f64 * 2.4;
            let tilt = Vector3::new(to.cos(), to.sin(), 0.0) * random.between(0.3, 0.8);
            let mut at = |low, high| random.between(low, high);
            let middle = Point3::new(at(-0.08, 0.08), at(-0.08, 0.08), at(0.1, 0.22));
            placed(board, middle, tilt, at(-3.0, 3.0))
        })
        .collect()
}

/// Placements in which a board stands upright amid the cameras, so that these see both of its sides.
pub(super) fn upright(board: &Board, count: usize) -> Vec<Isometry3<f64>> {
    let at = |k: usize| {
        let to = 2.4 * k as f64;
        let tilt = Vector3::new(to.cos(), to.sin(), 0.0) * 1.4;
        placed(board, Point3::new(0.02, -0.01, 0.12), tilt, 0.3)
    };
    (0..count).map(at).collect()
}

impl Truth {
    pub(super) fn new(board: Board, cameras: Vec<Camera>, placements: Vec<Isometry3<f64>>) -> Self {
        // Nobody glues two prints together to a tenth of a millimetre.
        let askew = Isometry3::new(
            Vector3::new(0.0008, -0.0006, 0.0),
            Vector3::new(0.0, 0.002, 0.004),
        );
        Self {
            cameras,
            placements,
            board,
            front_from_back: board.front_from_back() * askew,
            shape: BoardShape::default(),
        }
    }

    /// The corners of a face at a pose as a camera sees them; none if one is outside the picture or seen too obliquely.
    pub(super) fn sees(
        &self,
        camera: &Camera,
        rig_from_board: &Isometry3<f64>,
        face: Face,
    ) -> Option<Vec<Corner>> {
        let rig_from_face = match face {
            Face::Front => *rig_from_board,
            Face::Back => rig_from_board * self.front_from_back,
        };
        let away = rig_from_face * Vector3::z();
        let sight = (rig_from_face
            * self
                .board
                .corner_position(self.board.columns / 2, self.board.rows / 2)
            - camera.center())
        .normalize();
        if away.dot(&sight) < 0.3 {
            return None;
        }
        let surface = Surface::new(&self.board, face, self.shape);
        let all = (0..self.board.rows)
            .flat_map(|row| (0..self.board.columns).map(move |column| (column, row)));
        all.map(|(column, row)| {
            let p = self.board.corner_position(column, row);
            let (pixel, _) = camera.project(rig_from_face * surface.point([p.x, p.y]))?;
            camera
                .intrinsics
                .contains(pixel)
                .then_some(Corner { column, row, pixel })
        })
        .collect()
    }

    /// The session that the cameras record, with noise on each coordinate in pixels.
    pub(super) fn session(&self, noise_px: f64, random: &mut Random) -> Session {
        let mut views = Vec::new();
        for (placement, pose) in self.placements.iter().enumerate() {
            for (index, camera) in self.cameras.iter().enumerate() {
                for &face in self.board.faces() {
                    if let Some(corners) = self.sees(camera, pose, face) {
                        let corners = corners.into_iter().map(|c| {
                            let noise = Vector2::new(random.normal(), random.normal()) * noise_px;
                            Corner {
                                pixel: c.pixel + noise,
                                ..c
                            }
                        });
                        views.push(View {
                            camera: index,
                            placement,
                            face,
                            corners: corners.collect(),
                        });
                    }
                }
            }
        }
        let subject = |c: &Camera| SessionCamera {
            id: c.id.clone(),
            size: [c.intrinsics.width, c.intrinsics.height],
            known: None,
            start: None,
        };
        Session {
            board: self.board,
            cameras: self.cameras.iter().map(subject).collect(),
            placements: (0..self.placements.len())
                .map(|i| format!("p{i:02}"))
                .collect(),
            views,
        }
    }

    /// The rig's frame as a fit should find it from the frame of the truth, given the table's placement.
    pub(super) fn fit_from_truth(&self, table: usize) -> Isometry3<f64> {
        Isometry3::rotation(Vector3::x() * std::f64::consts::PI) * self.placements[table].inverse()
    }
}

/// Pixel distance.
pub(super) fn apart(a: Point2<f64>, b: Point2<f64>) -> f64 {
    (a - b).norm()
}
