//! The captures of the trial: each shape in each round, a round being a rig or a kind of fault. Captures are numbered,
//! and a capture's seed is its number, so that odd and even ones have the same shapes, rigs and faults.

use scand_core::calibration::{Camera, Intrinsics};
use scand_core::reconstruct::{Method, Scene};
use scand_lab::{CameraFault, CaptureFault, Options, Shape, Simulation};

/// Width and height of the colour cameras' pictures.
const SIZE: (usize, usize) = (960, 720);

/// So many shapes are tried, the first of all: those that the limits were set on, and that the results are of.
const SHAPES: usize = 15;

/// One capture.
pub(super) struct Case {
    /// What is simulated.
    pub(super) options: Options,
    /// How the model is made.
    pub(super) method: Method,
    /// Whether nothing is wrong with rig and capture.
    pub(super) is_sound: bool,
    calibration: Calibration,
}

/// Which calibration the scene has.
#[derive(Clone, Copy)]
enum Calibration {
    Own,
    /// Two cameras at each other's place.
    Exchanged,
    /// That of another rig of the same kind.
    Foreign,
    /// All colour cameras have focal lengths that are so many times the true ones.
    ColorFocal(f64),
    /// So have all depth cameras.
    DepthFocal(f64),
}

/// What is particular to a round.
#[derive(Clone, Copy)]
enum Round {
    /// Colour cameras, depth cameras, and the slant of the first of these in degrees.
    Rig(usize, usize, f64),
    /// The usual rig, and no depth is used.
    Hull,
    Turned,
    PrincipalPoints,
    DepthBias,
    Pictures,
    DepthShifted,
    Object,
    Calibrations,
    ColorFocal,
    DepthFocal,
    Material,
}

const ROUNDS: [Round; 17] = [
    Round::Rig(11, 1, 4.0),
    Round::Rig(11, 1, 4.0),
    Round::Rig(16, 2, 4.0),
    Round::Rig(8, 1, 4.0),
    Round::Rig(11, 1, 30.0),
    Round::Rig(11, 0, 4.0),
    Round::Hull,
    Round::Turned,
    Round::PrincipalPoints,
    Round::DepthBias,
    Round::Pictures,
    Round::DepthShifted,
    Round::Object,
    Round::Calibrations,
    Round::ColorFocal,
    Round::DepthFocal,
    Round::Material,
];

/// Captures in which each shape has been in each round.
pub(super) const ALL: usize = SHAPES * ROUNDS.len();

impl Case {
    /// Capture `number`: all shapes of the first round come first.
    pub(super) fn new(number: usize) -> Self {
        let (round, shape) = (number / SHAPES, number % SHAPES);
        let mut case = Self {
            options: Options {
                shape: Shape::ALL[shape],
                seed: number as u64,
                width: SIZE.0,
                height: SIZE.1,
                ..Options::default()
            },
            method: Method::Hybrid,
            is_sound: true,
            calibration: Calibration::Own,
        };
        case.options.depth.frames = 10;
        case.apply(ROUNDS[round % ROUNDS.len()], shape);
        case
    }

    fn apply(&mut self, round: Round, shape: usize) {
        let options = &mut self.options;
        let faults = &mut options.faults;
        // Each shape gets another camera and another amount.
        let of_camera = |amount| {
            vec![CameraFault {
                camera: format!("c{:02}", shape % 11),
                amount,
            }]
        };
        let of_capture = |amount| vec![CaptureFault { capture: 0, amount }];
        let kind = shape % 5;
        self.is_sound = matches!(round, Round::Rig(..) | Round::Hull);
        match round {
            Round::Rig(cameras, depth_cameras, slant) => {
                (options.cameras, options.depth_cameras) = (cameras, depth_cameras);
                options.depth_slant_deg = slant;
            }
            Round::Hull => self.method = Method::Hull,
            Round::Turned => faults.turned_deg = of_camera([0.05, 0.1, 0.2, 0.5, 1.0][kind]),
            Round::PrincipalPoints => faults.calibration_px = [0.2, 0.5, 1.0, 2.0, 4.0][kind],
            Round::DepthBias => options.depth.bias_mm = [4.0, 8.0, 12.0, 20.0, -15.0][kind],
            Round::Pictures => match kind {
                0 | 1 => faults.blurred_px = of_camera([2.0, 8.0][kind]),
                2 | 3 => faults.overexposed_stops = of_camera([1.0, 3.0][kind - 2]),
                _ => options.color.exposure_drift = 0.1,
            },
            Round::DepthShifted => {
                options.depth.misregistration_px = [1.0, 2.0, 4.0, 8.0, 16.0][kind]
            }
            Round::Object => match kind {
                0 => faults.lost_piece_mm = of_capture(15.0),
                1 | 2 => faults.cut_off = of_camera([0.1, 0.3][kind - 1]),
                3 => faults.no_depth = true,
                _ => faults.prop_mm = of_capture(20.0),
            },
            Round::Calibrations => match kind {
                0 => self.calibration = Calibration::Exchanged,
                1 => self.calibration = Calibration::Foreign,
                _ => faults.calibration_scale_percent = [0.5, 1.0, 2.0][kind - 2],
            },
            Round::ColorFocal => {
                let times = [0.94, 0.96, 1.04, 1.05, 1.08][kind];
                self.calibration = Calibration::ColorFocal(times);
            }
            Round::DepthFocal => {
                let times = [0.92, 0.95, 1.04, 1.06, 1.1][kind];
                self.calibration = Calibration::DepthFocal(times);
            }
            Round::Material => options.depth.object_bias_mm = [-4.0, 4.0, -8.0, 8.0, -2.0][kind],
        }
    }

    /// Whether a depth camera is used.
    pub(super) fn has_depth(&self) -> bool {
        self.options.depth_cameras > 0
            && self.method != Method::Hull
            && !self.options.faults.no_depth
    }

    /// What it is called in a table.
    pub(super) fn words(&self) -> String {
        let Options {
            shape,
            seed,
            cameras,
            depth_cameras,
            depth_slant_deg,
            ..
        } = &self.options;
        let calibration = match self.calibration {
            Calibration::Own => String::new(),
            Calibration::Exchanged => ", cameras exchanged".to_owned(),
            Calibration::Foreign => ", calibration of another rig".to_owned(),
            Calibration::ColorFocal(times) => format!(", focal lengths of colour times {times}"),
            Calibration::DepthFocal(times) => format!(", focal length of depth times {times}"),
        };
        let method = match self.method {
            Method::Hull => ", no depth used",
            _ => "",
        };
        format!(
            "{seed}: {shape:?}, {cameras} + {depth_cameras} cameras at {depth_slant_deg}°{method}{calibration}{}",
            self.fault()
        )
    }

    fn fault(&self) -> String {
        let Options {
            faults,
            depth,
            color,
            ..
        } = &self.options;
        let of_cameras = |what: &str, list: &[CameraFault]| {
            list.iter()
                .map(|f| format!(", {what} {} {}", f.camera, f.amount))
                .collect::<String>()
        };
        let of_captures = |what: &str, list: &[CaptureFault]| {
            list.iter()
                .map(|f| format!(", {what} {} mm", f.amount))
                .collect::<String>()
        };
        let unless = |is_usual: bool, words: String| if is_usual { String::new() } else { words };
        [
            of_cameras("turned by degrees", &faults.turned_deg),
            of_cameras("blurred by px", &faults.blurred_px),
            of_cameras("overexposed by stops", &faults.overexposed_stops),
            of_cameras("cut off by shares", &faults.cut_off),
            of_captures("lost piece of", &faults.lost_piece_mm),
            of_captures("prop of", &faults.prop_mm),
            unless(!faults.no_depth, ", no readings".to_owned()),
            unless(
                faults.calibration_px == 0.0,
                format!(", principal points off by {} px", faults.calibration_px),
            ),
            unless(
                faults.calibration_scale_percent == 0.0,
                format!(
                    ", calibration {} % too large",
                    faults.calibration_scale_percent
                ),
            ),
            unless(
                depth.bias_mm == 0.0,
                format!(", depth off by {} mm", depth.bias_mm),
            ),
            unless(
                depth.object_bias_mm == 0.0,
                format!(", depth of the object off by {} mm", depth.object_bias_mm),
            ),
            unless(
                depth.misregistration_px == 0.0,
                format!(", depth shifted by {} px", depth.misregistration_px),
            ),
            unless(color.exposure_drift < 0.05, ", light changed".to_owned()),
        ]
        .concat()
    }

    /// The scene, and the simulation that knows the truth.
    pub(super) fn scene(&self) -> (Scene, Simulation) {
        let simulation = Simulation::new(self.options.clone()).unwrap();
        let mut scene = simulation.scene(0);
        match self.calibration {
            Calibration::Own => {}
            Calibration::Exchanged => {
                let first = scene.colors[0].camera.clone();
                let second = std::mem::replace(&mut scene.colors[3].camera, first);
                scene.colors[0].camera = second;
            }
            Calibration::Foreign => {
                let other = Options {
                    seed: self.options.seed + 1_000_000,
                    ..self.options.clone()
                };
                let other = Simulation::new(other).unwrap();
                for (view, station) in scene.colors.iter_mut().zip(&other.rig().colors) {
                    view.camera = station.calibrated.clone();
                }
            }
            Calibration::ColorFocal(times) => {
                for view in &mut scene.colors {
                    view.camera = with_focal(&view.camera, times);
                }
            }
            Calibration::DepthFocal(times) => {
                for view in &mut scene.depths {
                    view.camera.camera = with_focal(&view.camera.camera, times);
                }
            }
        }
        (scene, simulation)
    }
}

/// A camera whose focal lengths are so many times as long.
fn with_focal(camera: &Camera, times: f64) -> Camera {
    let lens = camera.intrinsics;
    let (width, height) = (lens.width, lens.height);
    let focal_px = lens.focal_px * times;
    let lens = Intrinsics::new(width, height, focal_px, lens.center_px, lens.distortion).unwrap();
    Camera::new(camera.id.clone(), lens, camera.rig_from_camera)
}
