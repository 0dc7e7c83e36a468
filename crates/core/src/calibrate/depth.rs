//! Fits how the depth cameras' readings relate to true distances, from the boards' planes or from a table.

use super::Error;
use super::detections::placement_names;
use crate::calibration::fit::{
    DepthError, DepthMisfit, Fit, FittedCamera, LeftOutShare, ReasonKind, Slope,
};
use crate::calibration::response::{
    BoardsBias, Cause, DepthTable, DistanceBias, Misfit, PaperFit, PlaneFit, PlaneParameters,
    PlaneView, ReadingChange, bias_on_boards, fit_plane, mean_readings,
};
use crate::calibration::{Board, DepthResponse};
use crate::capture::Placements;
use crate::frame::CameraId;
use crate::image::Grid;
use nalgebra::{Isometry3, Vector3};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Where the depth cameras' responses come from.
#[derive(Debug)]
pub enum DepthMethod {
    /// The planes of the boards that they saw.
    Plane(PlaneParameters),
    /// A table of measurements, as in the paper, that is held against the boards that they saw.
    Table(Box<Table>, PlaneParameters),
    /// Nowhere.
    None,
}

/// What a table says, and the response that it makes.
#[derive(Clone, Debug)]
pub struct Table {
    /// The paper's lines and quartic.
    pub fit: PaperFit,
    response: DepthResponse,
}

impl Table {
    /// Reads a table and fits a response to it.
    ///
    /// # Errors
    /// If it cannot be read, or no response be fitted to it.
    pub fn load(path: &Path) -> Result<Self, Error> {
        let failed = |cause| Error::Response {
            path: path.into(),
            cause,
        };
        let fit = PaperFit::of(&DepthTable::load(path).map_err(Error::Table)?).map_err(failed)?;
        let response = fit.response().map_err(failed)?;
        Ok(Self { fit, response })
    }
}

/// What was found of the depth cameras.
#[derive(Debug, Default)]
pub struct Depth {
    /// The response of each camera that saw enough boards.
    pub planes: BTreeMap<CameraId, PlaneFit>,
    /// What the table says, for all cameras.
    pub table: Option<Table>,
    /// What each camera's boards say of the table.
    pub of_table: BTreeMap<CameraId, DepthError>,
    /// Cameras for which no response could be fitted, and why.
    pub unfitted: BTreeMap<CameraId, String>,
    /// Responses that were given and are kept, because none was found.
    pub given: BTreeMap<CameraId, DepthResponse>,
    /// What a person should know.
    pub words: Vec<String>,
    /// What could not be read.
    pub lost: Vec<String>,
}

/// Fits the responses of all depth cameras that were fitted; of cameras for which none is found, those are kept that
/// were given.
pub(super) fn fit_responses(
    method: DepthMethod,
    recordings: &[Placements],
    fit: &Fit,
    depth_cameras: &[CameraId],
    given: BTreeMap<CameraId, DepthResponse>,
) -> Depth {
    let mut depth = Depth::default();
    let cameras = fit.cameras.iter();
    let fitted = cameras.filter(|c| depth_cameras.contains(&c.camera.id));
    match method {
        DepthMethod::Plane(parameters) => {
            for camera in fitted {
                depth.add_planes(recordings, fit, camera, &parameters);
            }
        }
        DepthMethod::Table(table, parameters) => {
            for camera in fitted {
                depth.hold_table_against_boards(recordings, fit, camera, &table, &parameters);
            }
            depth.table = Some(*table);
        }
        DepthMethod::None => {}
    }
    let is_fitted = |id: &CameraId| fit.cameras.iter().any(|c| c.camera.id == *id);
    for (id, response) in given {
        let is_found = depth_cameras.contains(&id) && depth.response(&id).is_some();
        if is_fitted(&id) && !is_found {
            depth.keep(id, response);
        }
    }
    depth
}

impl Depth {
    /// The response of a camera; `None` where nothing was found.
    pub(super) fn response(&self, id: &CameraId) -> Option<DepthResponse> {
        let plane = self.planes.get(id).map(|fit| fit.response);
        plane.or_else(|| {
            let response = self.table.as_ref()?.response;
            let of_boards = self.of_table.get(id).map(|error| error.at_most);
            let uncertainty = of_boards.unwrap_or(response.uncertainty);
            Some(DepthResponse {
                uncertainty: uncertainty.min(DepthResponse::MOST_UNCERTAINTY),
                ..response
            })
        })
    }

    /// Keeps a response that was given, and tells of it.
    fn keep(&mut self, id: CameraId, response: DepthResponse) {
        // A recording whose depth camera was not calibrated has this one, which nobody measured.
        if response == DepthResponse::default() {
            return;
        }
        if !self.unfitted.contains_key(&id) {
            self.words.push(format!(
                "depth of {id}: no response was fitted, and the one that was given is kept"
            ));
        }
        self.given.insert(id, response);
    }

    /// The responses that were found for the depth cameras, and those that are kept.
    pub(super) fn responses(
        &self,
        depth_cameras: &[CameraId],
    ) -> BTreeMap<CameraId, DepthResponse> {
        let mut all = self.given.clone();
        let found = depth_cameras.iter();
        all.extend(found.filter_map(|id| Some((id.clone(), self.response(id)?))));
        all
    }

    /// What there is to say of each camera for which no response could be fitted.
    pub fn unfitted_words(&self) -> impl Iterator<Item = (&CameraId, String)> {
        self.unfitted.iter().map(move |(id, why)| {
            let words = match self.given.contains_key(id) {
                true => format!(
                    "depth camera {id} keeps the response that was given, because none could be fitted: {why}"
                ),
                false => format!("depth camera {id} has no response: {why}"),
            };
            (id, words)
        })
    }

    /// The slopes that the boards determine.
    pub(super) fn slopes(&self) -> BTreeMap<CameraId, Slope> {
        let slope = |(id, fit): (&CameraId, &PlaneFit)| {
            let slope = Slope {
                value: fit.response.slope,
                deviation: fit.slope_deviation?,
            };
            Some((id.clone(), slope))
        };
        self.planes.iter().filter_map(slope).collect()
    }

    /// The figures that the verdict judges.
    pub(super) fn found(&self) -> BTreeMap<CameraId, Result<DepthError, String>> {
        let error = |fit: &PlaneFit| DepthError {
            seen: largest(&fit.bias),
            at_most: fit.response.uncertainty,
            misfit: fit.misfit.as_ref().map(misfit),
            boards: LeftOutShare {
                read: fit.views.len() + fit.left_out.len(),
                left_out: fit.left_out.len(),
            },
            change: fit.change.as_ref().map(ReadingChange::words),
        };
        let fitted = self.planes.iter();
        let fitted = fitted.map(|(id, fit)| (id, Ok(error(fit))));
        let of_table = self.of_table.iter();
        let of_table = of_table.map(|(id, error)| (id, Ok(error.clone())));
        let unfitted = self.unfitted_words().map(|(id, words)| (id, Err(words)));
        let all = fitted.chain(of_table).chain(unfitted);
        all.map(|(id, found)| (id.clone(), found)).collect()
    }

    fn add_planes(
        &mut self,
        recordings: &[Placements],
        fit: &Fit,
        camera: &FittedCamera,
        parameters: &PlaneParameters,
    ) {
        let id = &camera.camera.id;
        let views = self.views_of(recordings, fit, camera);
        let views: Vec<PlaneView<'_>> = views.iter().map(BoardView::plane).collect();
        match fit_plane(&camera.camera.intrinsics, &fit.board, &views, parameters) {
            Ok(mut found) => {
                let own = &mut found.response.uncertainty;
                *own = own
                    .hypot(OF_POSE * along_axis(camera))
                    .min(DepthResponse::MOST_UNCERTAINTY);
                self.say_left_out(id, found.unread.iter().chain(&found.left_out));
                let misfit = found.misfit.iter();
                self.words
                    .extend(misfit.map(|misfit| format!("depth of {id}: {}", misfit.words())));
                self.planes.insert(id.clone(), found);
            }
            Err(error) => {
                self.unfitted.insert(id.clone(), error.to_string());
            }
        }
    }

    /// A table says what a depth camera reads at distances that were measured by hand: the boards show whether these
    /// were measured from where its lens is.
    fn hold_table_against_boards(
        &mut self,
        recordings: &[Placements],
        fit: &Fit,
        camera: &FittedCamera,
        table: &Table,
        parameters: &PlaneParameters,
    ) {
        let id = &camera.camera.id;
        let views = self.views_of(recordings, fit, camera);
        let views: Vec<PlaneView<'_>> = views.iter().map(BoardView::plane).collect();
        let (lens, response) = (&camera.camera.intrinsics, &table.response);
        let found = bias_on_boards(lens, &fit.board, &views, response, parameters);
        self.say_left_out(id, found.unread.iter().chain(&found.left_out));
        let error = error_of_table(&table.fit, &found);
        self.words.push(match found.bias.is_empty() {
            true => format!(
                "depth of {id}: it read no board between {:.2} and {:.2} m, so that nothing confirms the table",
                table.fit.range[0], table.fit.range[1]
            ),
            false => format!(
                "depth of {id}: its distances by the table are at most {:.2} mm off the boards",
                1e3 * error.seen
            ),
        });
        self.of_table.insert(id.clone(), error);
    }

    /// What a depth camera read of the placements that the fit uses.
    fn views_of(
        &mut self,
        recordings: &[Placements],
        fit: &Fit,
        camera: &FittedCamera,
    ) -> Vec<BoardView> {
        let camera_from_front = |name: &str| {
            let placement = fit.placements.iter().find(|p| p.name == name)?;
            Some(camera.camera.rig_from_camera.inverse() * placement.rig_from_board)
        };
        let (id, back, lost) = (&camera.camera.id, fit.front_from_back, &mut self.lost);
        views(recordings, id, &fit.board, back, &camera_from_front, lost)
    }

    fn say_left_out<'a>(
        &mut self,
        id: &CameraId,
        left_out: impl Iterator<Item = &'a (String, String)>,
    ) {
        let words = left_out
            .map(|(name, why)| format!("depth of {id}: placement {name} is left out: {why}"));
        self.words.extend(words);
    }
}

/// The largest bias at any distance, in metres.
fn largest(bias: &[DistanceBias]) -> f64 {
    bias.iter().map(|b| b.bias.abs()).fold(0.0, f64::max)
}

/// The error of a table's response: what the table's line leaves of it, and what the boards show.
fn error_of_table(table: &PaperFit, found: &BoardsBias) -> DepthError {
    let seen = largest(&found.bias);
    DepthError {
        seen,
        at_most: table.largest_error.max(seen),
        misfit: None,
        boards: LeftOutShare {
            read: found.read,
            left_out: found.left_out.len(),
        },
        change: found.change.as_ref().map(ReadingChange::words),
    }
}

/// How many standard deviations of the depth camera's position its stated "bias at most" covers. Two were too few: in a
/// session whose board moved, 1.76 mm remained where 1.63 mm were stated.
const OF_POSE: f64 = 3.0;

/// Standard deviation of a camera's centre along its axis, in metres: by so much all boards may be nearer or farther.
/// The error of its focal length is in it, for the two are fitted to the same views.
fn along_axis(camera: &FittedCamera) -> f64 {
    let axis = camera.camera.rig_from_camera * Vector3::z();
    camera.uncertainty.position_along(&axis)
}

/// The burst of each placement whose board's front lies where `camera_from_front` says, its mean taken, with the pose
/// of the face that it shows. What cannot be read goes to `lost`.
pub(super) fn views(
    recordings: &[Placements],
    id: &CameraId,
    board: &Board,
    front_from_back: Isometry3<f64>,
    camera_from_front: &dyn Fn(&str) -> Option<Isometry3<f64>>,
    lost: &mut Vec<String>,
) -> Vec<BoardView> {
    let mut views = Vec::new();
    for (recording, names) in recordings.iter().zip(placement_names(recordings)) {
        let all = recording.readings();
        for burst in all.iter().filter(|b| b.camera == *id) {
            let placement = names.get(&burst.placement).cloned().unwrap_or_default();
            let Some(front) = camera_from_front(&placement) else {
                continue;
            };
            let frames = match recording.depth(burst) {
                Ok(frames) => frames,
                Err(error) => {
                    lost.push(error.to_string());
                    continue;
                }
            };
            match mean_readings(&frames) {
                Some(readings) => views.push(BoardView {
                    placement,
                    camera_from_face: seen(board, front, front_from_back),
                    readings,
                }),
                None => lost.extend(unequal_words(id, &placement, &frames)),
            }
        }
    }
    views
}

/// That frames of several sizes have no mean; `None` if there is no frame.
fn unequal_words(id: &CameraId, placement: &str, frames: &[Grid<u16>]) -> Option<String> {
    let sizes: BTreeSet<[usize; 2]> = frames.iter().map(|f| [f.width(), f.height()]).collect();
    let sizes: Vec<String> = sizes.iter().map(|[w, h]| format!("{w}x{h}")).collect();
    (!sizes.is_empty()).then(|| {
        format!(
            "depth camera {id}: its frames of {placement} have {} pixels, expected one size; they are left out",
            sizes.join(" and ")
        )
    })
}

/// What a depth camera read of one placement.
pub(super) struct BoardView {
    placement: String,
    camera_from_face: Isometry3<f64>,
    readings: Grid<f32>,
}

impl BoardView {
    pub(super) fn plane(&self) -> PlaneView<'_> {
        PlaneView {
            placement: &self.placement,
            camera_from_face: self.camera_from_face,
            readings: &self.readings,
        }
    }
}

/// The pose of the face that a camera sees, from the front's in the camera's frame.
fn seen(board: &Board, front: Isometry3<f64>, front_from_back: Isometry3<f64>) -> Isometry3<f64> {
    let eye = front.inverse() * nalgebra::Point3::origin();
    match board.two_sided && eye.z > 0.0 {
        true => front * front_from_back,
        false => front,
    }
}

/// What does not fit, for the verdict.
fn misfit(found: &Misfit) -> DepthMisfit {
    DepthMisfit {
        held_out: found.held_out,
        kind: match found.causes.first() {
            Some(Cause::Misregistered(_)) => ReasonKind::DepthMisregistered,
            Some(Cause::Bowl(_)) => ReasonKind::DepthBowl,
            Some(Cause::Curve(_)) => ReasonKind::DepthNotLinear,
            None => ReasonKind::DepthBias,
        },
        words: found.words(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::response::{Correction, Measurement};

    /// A depth camera whose readings do not fit.
    fn depth(cause: Cause) -> Depth {
        let fit = PlaneFit {
            response: DepthResponse::default(),
            slope_deviation: None,
            bias: Vec::new(),
            views: Vec::new(),
            unread: Vec::new(),
            left_out: Vec::new(),
            change: None,
            correction: Correction {
                coefficients: [0.0; 10],
                held_out: 1e-3,
                held_out_corrected: 1e-3,
                pays: false,
            },
            misfit: Some(Misfit {
                held_out: 1e-3,
                explained: 2e-4,
                causes: vec![cause],
                part: None,
            }),
        };
        Depth {
            planes: BTreeMap::from([(CameraId::new("kinect").unwrap(), fit)]),
            ..Depth::default()
        }
    }

    #[test]
    fn a_table_is_judged_by_what_its_line_leaves_and_by_the_boards() {
        let rows = [(0.7, 700.0), (1.0, 1003.0), (1.3, 1300.0)];
        let rows = rows.map(|(distance, depth)| Measurement {
            distance,
            depth,
            width: f64::NAN,
        });
        let fit = PaperFit::of(&DepthTable { rows: rows.into() }).unwrap();
        let response = fit.response().unwrap();
        let of_line = fit.largest_error;
        assert!((0.001..0.003).contains(&of_line), "{of_line}");
        let judged = |bias: &[f64]| {
            let bias = bias.iter().map(|&bias| DistanceBias {
                distance: 1.0,
                views: 1,
                pixels: 1000,
                bias,
                bias_before: bias,
                spread: 0.001,
            });
            let boards = BoardsBias {
                bias: bias.collect(),
                read: 3,
                unread: Vec::new(),
                left_out: Vec::new(),
                change: None,
            };
            let id = CameraId::new("kinect").unwrap();
            let error = error_of_table(&fit, &boards);
            let depth = Depth {
                table: Some(Table {
                    fit: fit.clone(),
                    response,
                }),
                of_table: BTreeMap::from([(id.clone(), error)]),
                ..Depth::default()
            };
            let found = depth.found()[&id].clone().unwrap();
            let stated = depth.response(&id).unwrap().uncertainty;
            assert_eq!(stated, found.at_most);
            [found.seen, found.at_most]
        };
        assert_eq!(judged(&[0.001, -0.04]), [0.04, 0.04]);
        assert_eq!(judged(&[0.0005]), [0.0005, of_line]);
        assert_eq!(judged(&[]), [0.0, of_line]);
    }

    #[test]
    fn frames_of_several_sizes_are_told_of() {
        let id = CameraId::new("kinect").unwrap();
        let frames = [(640, 480), (320, 240)].map(|(w, h)| Grid::filled(w, h, 800));
        let words = "depth camera kinect: its frames of p3 have 320x240 and 640x480 pixels, expected one size; they are \
                     left out";
        assert_eq!(mean_readings(&frames), None);
        assert_eq!(unequal_words(&id, "p3", &frames).as_deref(), Some(words));
        assert_eq!(unequal_words(&id, "p3", &[]), None);
    }

    #[test]
    fn a_response_that_was_given_is_kept_and_told_of_where_none_could_be_fitted() {
        let id = CameraId::new("kinect").unwrap();
        let unfitted = || Depth {
            unfitted: BTreeMap::from([(id.clone(), "too few boards".to_owned())]),
            ..Depth::default()
        };
        let told = |depth: &Depth| depth.found()[&id].clone().unwrap_err();
        let cameras = std::slice::from_ref(&id);
        let given = DepthResponse {
            slope: 0.00104,
            ..DepthResponse::default()
        };
        let mut depth = unfitted();
        depth.keep(id.clone(), given);
        assert_eq!(depth.responses(cameras).get(&id), Some(&given));
        let words = "depth camera kinect keeps the response that was given, because none could be fitted: too few boards";
        assert_eq!(told(&depth), words);
        assert!(depth.words.is_empty(), "{:?}", depth.words);
        // What nobody measured is no response.
        let mut depth = unfitted();
        depth.keep(id.clone(), DepthResponse::default());
        assert!(depth.responses(cameras).is_empty());
        let words = "depth camera kinect has no response: too few boards";
        assert_eq!(told(&depth), words);
        // Where none was to be fitted, it is no reason to doubt, but told.
        let mut depth = Depth::default();
        depth.keep(id.clone(), given);
        assert!(depth.found().is_empty());
        assert!(depth.words[0].contains("the one that was given is kept"));
    }

    #[test]
    fn readings_that_do_not_fit_are_told_with_what_would_explain_them() {
        for (cause, kind, words) in [
            (
                Cause::Misregistered([3.0, -1.0]),
                ReasonKind::DepthMisregistered,
                "displaced against its colour picture by +3.0 px",
            ),
            (
                Cause::Bowl(0.004),
                ReasonKind::DepthBowl,
                "which are 4.0 mm deeper at 1 m",
            ),
            (
                Cause::Curve(0.002),
                ReasonKind::DepthNotLinear,
                "not linear in the distance, by 2.0 mm",
            ),
        ] {
            let found = depth(cause).found();
            let error = found.values().next().unwrap().as_ref().unwrap();
            let told = error.misfit.as_ref().unwrap();
            assert_eq!((told.kind, told.held_out), (kind, 1e-3));
            assert!(told.words.contains(words), "{}", told.words);
            assert!(told.words.contains("80 %"), "{}", told.words);
        }
    }
}
