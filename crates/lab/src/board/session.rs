//! The frames that the rig's cameras deliver when a board is shown to them.

use super::super::burst::{Burst, DEPTH_PERIOD};
use super::super::check::{check, check_faults};
use super::super::color::expose;
use super::super::depth::DepthScene;
use super::super::options::{ColorSensor, Faults};
use super::super::random::Random;
use super::super::render::Rendered;
use super::super::session::{BEGIN, depth_color, trigger_time};
use super::super::{Capture, DepthStation, Error, Options, Rig, invalid, within_range};
use super::options::{BoardFaults, BoardOptions};
use super::paint::{Directions, rendered};
use super::placements::{Placement, choose};
use super::plate::Plate;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use scand_core::calibration::{Board, Camera, DepthResponse, RigCalibration};
use scand_core::frame::{CaptureId, Frame, Stream, Timestamp, Trigger};

/// A board among cameras, ready to be shown.
pub struct BoardSession {
    options: Options,
    boards: BoardOptions,
    board: Board,
    declared: Board,
    pub(super) plate: Plate,
    rig: Rig,
    placements: Vec<Placement>,
    /// Of the colour cameras and then the depth cameras.
    directions: Vec<Directions>,
}

impl BoardSession {
    /// Sets up the rig that [`super::super::Simulation`] sets up with the same options, and chooses placements. Nothing
    /// is rendered yet.
    ///
    /// # Errors
    /// If an option cannot be met, or a fault names a camera or placement that does not exist.
    pub fn new(options: Options, boards: BoardOptions) -> Result<Self, Error> {
        check(&options)?;
        let object = options.shape.mesh(options.spacing_mm * 1e-3);
        let rig = Rig::new(&options, &object)?;
        check_faults(&options, &rig)?;
        check_board_faults(&boards, &rig)?;
        let board: Board = boards.board.parse()?;
        let declared = match &boards.declared {
            Some(text) => text.parse()?,
            None => board,
        };
        let mut placements = choose(&board, &rig, options.seed, boards.placements);
        apply_faults(&mut placements, &board, &boards.faults);
        let plate = Plate {
            board,
            front_from_back: misprinted(&board, options.seed, boards.misprint_mm),
            shape: boards.shape(),
        };
        let lenses = rig.colors.iter().map(|s| s.actual.intrinsics);
        let lenses = lenses.chain(rig.depths.iter().map(|s| s.actual.camera.intrinsics));
        let lenses: Vec<_> = lenses.collect();
        Ok(Self {
            directions: lenses.par_iter().map(Directions::new).collect(),
            options,
            boards,
            board,
            declared,
            plate,
            rig,
            placements,
        })
    }

    /// What was asked of the rig.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// What was asked of the board.
    pub fn board_options(&self) -> &BoardOptions {
        &self.boards
    }

    /// The board that is shown.
    pub fn board(&self) -> &Board {
        &self.board
    }

    /// The board that the recording says is shown.
    pub fn declared_board(&self) -> &Board {
        &self.declared
    }

    /// The cameras.
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// Where the board is at each trigger; of one that moves, where the first camera sees it.
    pub fn placements(&self) -> &[Placement] {
        &self.placements
    }

    /// Where the back really lies: a point of its frame in the front's.
    pub fn front_from_back(&self) -> Isometry3<f64> {
        self.plate.front_from_back
    }

    /// The true cameras: a calibration should find these, up to the choice of the rig's frame.
    pub fn truth(&self) -> RigCalibration {
        let colors = self.rig.colors.iter().map(|s| (s.actual.clone(), None));
        let depths = self.rig.depths.iter().map(|s| {
            let response = DepthResponse {
                intercept: s.actual.response.intercept - self.options.depth.bias_mm * 1e-3,
                ..s.actual.response
            };
            (s.actual.camera.clone(), Some(response))
        });
        let cameras = colors.chain(depths);
        RigCalibration {
            volume: None,
            verdict: None,
            at_object_mm: None,
            cameras: cameras.map(|c| (c.0.id.clone(), c)).collect(),
        }
    }

    /// What the cameras give to placement `index`.
    ///
    /// # Errors
    /// Never fails for a valid index.
    pub fn capture(&self, index: usize) -> Result<Capture, Error> {
        let trigger = Trigger {
            id: CaptureId::new(&format!("placement-{index:03}"))?,
            time: trigger_time(index),
            source: "simulation".to_owned(),
            press_id: None,
            subject: None,
            placement: None,
        };
        let colors = self.rig.colors.par_iter().enumerate();
        let colors = colors
            .filter(|(_, s)| !self.is_missing(&s.actual))
            .map(|(k, s)| self.color_frame(k, &s.actual, index));
        let mut frames: Vec<Frame> = colors.collect();
        for (k, station) in self.rig.depths.iter().enumerate() {
            if !self.is_missing(&station.actual.camera) {
                frames.extend(self.depth_frames(k, station, index));
            }
        }
        frames.sort_by(|a, b| {
            (a.timestamp, a.stream, &a.camera).cmp(&(b.timestamp, b.stream, &b.camera))
        });
        Ok(Capture { trigger, frames })
    }

    fn is_missing(&self, camera: &Camera) -> bool {
        let missing = &self.options.faults.missing;
        missing.iter().any(|name| name == camera.id.as_str())
    }

    /// Where a camera, `k` of all, sees the board at a placement.
    fn pose(&self, index: usize, k: usize) -> Isometry3<f64> {
        let moved = BoardFaults::amount(&self.boards.faults.moved_mm, index) * 1e-3;
        let last = (self.directions.len() - 1).max(1) as f64;
        let by = Vector3::new(0.8, 0.6, 0.0) * (moved * k as f64 / last);
        Translation3::from(by) * self.placements[index].rig_from_board
    }

    /// Light on the sensor of a camera, `k` of all.
    fn rendered(&self, k: usize, camera: &Camera, index: usize) -> Rendered {
        let (faults, id) = (&self.boards.faults, camera.id.as_str());
        if faults.blind.iter().any(|name| name == id) {
            return Rendered::background(camera);
        }
        let blur_px = self
            .options
            .color
            .blur_px
            .hypot(Faults::amount(&self.options.faults.blurred_px, id))
            .hypot(BoardFaults::amount(&faults.blurred_px, index));
        let pose = self.pose(index, k);
        rendered(camera, &self.directions[k], &self.plate, &pose, blur_px)
    }

    fn color_frame(&self, k: usize, camera: &Camera, index: usize) -> Frame {
        let Options {
            seed,
            color,
            faults,
            ..
        } = &self.options;
        let id = camera.id.as_str();
        let mut random = Random::new(&[*seed, 24, k as u64, index as u64]);
        let delay = random.between(2e5, 3e6) as u64 + faults.late_ns(id);
        let stops = Faults::amount(&faults.overexposed_stops, id);
        let exposure = (1.0 + color.exposure_drift * random.normal()) * stops.exp2();
        let key = [*seed, 23, k as u64, index as u64];
        let gains = [exposure as f32; 3];
        Frame {
            camera: camera.id.clone(),
            stream: Stream::Color,
            timestamp: Timestamp(trigger_time(index).0 + delay),
            picture: expose(&self.rendered(k, camera, index), color, gains, key),
        }
    }

    /// A burst of depth frames with their colour pictures, of depth camera `k`.
    fn depth_frames(&self, k: usize, station: &DepthStation, index: usize) -> Vec<Frame> {
        let seed = self.options.seed;
        let camera = &station.actual.camera;
        let of_all = self.rig.colors.len() + k;
        let mesh = self.plate.mesh(&self.pose(index, of_all));
        let is_blind = self
            .boards
            .faults
            .blind
            .iter()
            .any(|id| id == camera.id.as_str());
        let scene = DepthScene::new(&self.options, station, (!is_blind).then_some(&mesh));
        let rendered = self.rendered(of_all, camera, index);
        let sensor: ColorSensor = depth_color(&self.options);
        let mut random = Random::new(&[seed, 25, k as u64, index as u64]);
        let start = trigger_time(index).0
            + (random.uniform() * DEPTH_PERIOD as f64) as u64
            + self.options.faults.late_ns(camera.id.as_str());
        Burst {
            options: &self.options,
            station,
            camera: k as u64,
            scene: &scene,
            rendered: &rendered,
            sensor: &sensor,
            capture: index,
            start,
            noise: 26,
        }
        .frames()
    }

    /// When the session begins.
    pub fn begin(&self) -> Timestamp {
        Timestamp(BEGIN)
    }
}

/// The pose of a back that was glued on slightly shifted and turned.
fn misprinted(board: &Board, seed: u64, about_mm: f64) -> Isometry3<f64> {
    let mut random = Random::new(&[seed, 27]);
    let off = about_mm * 1e-3;
    let by = Translation3::new(
        off * random.between(-1.0, 1.0),
        off * random.between(-1.0, 1.0),
        off * random.between(0.0, 0.5),
    );
    // Turned by as much as moves a corner of the board by the same.
    let turn = off / (board.square * board.columns as f64) * random.between(-1.0, 1.0);
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
    by * board.front_from_back() * turn
}

fn apply_faults(placements: &mut [Placement], board: &Board, faults: &BoardFaults) {
    for &k in &faults.turned_over {
        let [x, y] = [board.columns - 1, board.rows - 1].map(|n| n as f64 * board.square);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
        let about_middle = Isometry3::from_parts(Translation3::new(x, y, 0.0), turn);
        placements[k].rig_from_board *= about_middle;
    }
    let mut duplicates = faults.duplicate.clone();
    duplicates.sort_unstable();
    for k in duplicates {
        placements[k] = placements[k - 1];
    }
}

fn check_board_faults(boards: &BoardOptions, rig: &Rig) -> Result<(), Error> {
    let count = boards.placements;
    within_range("placements", count as f64, [1.0, 1000.0], "")?;
    within_range("misprint", boards.misprint_mm, [0.0, 10.0], " mm")?;
    for bend in boards.bend_mm {
        within_range("bend", bend, [-20.0, 20.0], " mm")?;
    }
    within_range("stretch", boards.stretch_percent, [-5.0, 5.0], " %")?;
    let faults = &boards.faults;
    if let Some(k) = faults.placements().find(|&k| k >= count) {
        return Err(invalid(
            "placement of a fault",
            k,
            "less than the number of placements",
        ));
    }
    if faults.duplicate.contains(&0) {
        return Err(invalid(
            "duplicate placement",
            0,
            "one that has another before it",
        ));
    }
    let amounts = [
        (&faults.moved_mm, "movement", 500.0, " mm"),
        (&faults.blurred_px, "blur", 20.0, " px"),
    ];
    for (list, what, most, unit) in amounts {
        for fault in list {
            within_range(what, fault.amount, [0.0, most], unit)?;
        }
    }
    let colors = rig.colors.iter().map(|s| s.actual.id.as_str());
    let depths = rig.depths.iter().map(|s| s.actual.camera.id.as_str());
    let known: Vec<&str> = colors.chain(depths).collect();
    match faults.blind.iter().find(|id| !known.contains(&id.as_str())) {
        Some(id) => Err(invalid("blind camera", id, "the id of a camera of the rig")),
        None => Ok(()),
    }
}
