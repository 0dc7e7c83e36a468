//! Pieces of a model that no silhouette requires: wherever a camera has such a piece in its picture, other pieces cover
//! the same part of the silhouette. It may be an object, or a phantom that lies beyond the frames or where cones meet
//! beside the object. A part that leaves the frame of a camera whose silhouette is cut there is a piece of its own.
//! Nothing here removes a piece.

use super::readings::{Readings, beneath};
use crate::mesh::{Bvh, Components, Mesh, bounding_box, components, extract, rasterize};
use crate::reconstruct::hull::Cone;
use crate::reconstruct::{Model, Provenance};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Longest side, in cells, of the grids that pieces are drawn on.
const CELLS: f32 = 400.0;
/// Share of the cells that a piece covers which it must cover alone to be required: contours that err leave seams.
const LEAST_ALONE: f64 = 0.05;
/// Share of the whole area below which a part beyond a frame is not judged: the grids are too coarse for a sliver.
const LEAST_AREA: f64 = 0.01;
/// Share of a piece's vertices from which on the piece counts as read by a depth camera.
const LEAST_READ: f64 = 0.05;
/// Cosine between normal and view from which on a place faces a depth camera.
const FACING: f64 = 0.15;
/// Share of the way to the rest of the model that is stated as expected error: the way is a bound, for the piece may be
/// a phantom.
const OF_WAY: f64 = 0.5;
/// The first value of a pixel that is object, or of which a camera says nothing.
const IS_SET: u8 = 128;

/// A piece of a model that no silhouette requires.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct UnrequiredPiece {
    /// Cubic metres; of a part beyond a frame those beyond it.
    pub volume: f64,
    /// Its lowest and highest corner in the rig's frame, in metres.
    pub bounds: [[f32; 3]; 2],
}

/// Finds the pieces of a model that neither a silhouette of `cones` nor a reading requires, and marks what of them lies
/// on the hull as unseen, with half the way to the rest of the model as its expected error at least. Of pieces that
/// explain the same part of the silhouettes, the largest is kept. Returns the marked pieces, the largest first; none
/// where the model is in one piece.
pub fn mark_unrequired(
    model: &mut Model,
    cones: &[Cone],
    readings: &[Readings],
) -> Vec<UnrequiredPiece> {
    let pieces = Pieces::of(&model.mesh, cones);
    if pieces.smallest_first.len() < 2 {
        return Vec::new();
    }
    let triangles = pieces.triangles();
    let pictures = cones.par_iter().map(|cone| {
        let cells = covered(cone, &model.mesh.vertices, &triangles);
        Picture::new(cells)
    });
    let pictures: Vec<Picture> = pictures.collect();
    let is_read: Vec<bool> = pieces
        .smallest_first
        .iter()
        .map(|&piece| is_read(model, &pieces.found, piece, readings))
        .collect();
    let found: Vec<u32> = unrequired(pictures, &is_read)
        .into_iter()
        .map(|place| pieces.smallest_first[place])
        .collect();
    mark(model, &pieces, &found);
    let describe = |&piece: &u32| pieces.describe(piece);
    found.iter().rev().filter_map(describe).collect()
}

/// A surface in pieces: its separate parts, each divided where it leaves the frame of a camera whose silhouette is cut.
struct Pieces {
    /// The surface without the triangles between pieces.
    mesh: Mesh,
    found: Components,
    /// Their volumes in cubic metres, closed where they were divided.
    volumes: Vec<f64>,
    /// Those that are judged, by their area.
    smallest_first: Vec<u32>,
}

impl Pieces {
    fn of(surface: &Mesh, cones: &[Cone]) -> Self {
        let cut: Vec<&Cone> = cones.iter().filter(|cone| is_cut(cone)).collect();
        let leaves = |p: &Point3<f32>| cut.iter().any(|cone| !is_framed(cone, p.cast()));
        let leaving: Vec<bool> = surface.vertices.par_iter().map(leaves).collect();
        let is_of_one = |triangle: &&[u32; 3]| {
            let [a, b, c] = triangle.map(|v| leaving[v as usize]);
            a == b && b == c
        };
        let triangles = surface.triangles.iter().filter(is_of_one).copied();
        let mesh = Mesh {
            vertices: surface.vertices.clone(),
            triangles: triangles.collect(),
        };
        let found = components(&mesh);
        let borders = borders(surface, &found);
        let volumes = volumes(&mesh, &found, &borders);
        let area = |piece: u32| found.parts[piece as usize].area;
        let all = 0..found.parts.len() as u32;
        let whole: f64 = all.clone().map(area).sum();
        // A cavity is no solid.
        let is_judged = |&piece: &u32| match borders[piece as usize] {
            Some(_) => area(piece) >= LEAST_AREA * whole,
            None => volumes[piece as usize] > 0.0,
        };
        let mut smallest_first: Vec<u32> = all.filter(is_judged).collect();
        smallest_first.sort_by(|&a, &b| area(a).total_cmp(&area(b)));
        Self {
            mesh,
            found,
            volumes,
            smallest_first,
        }
    }

    /// The triangles of each piece that is judged.
    fn triangles(&self) -> Vec<Vec<[u32; 3]>> {
        let mut places: Vec<Option<usize>> = vec![None; self.found.parts.len()];
        for (place, &piece) in self.smallest_first.iter().enumerate() {
            places[piece as usize] = Some(place);
        }
        let mut triangles = vec![Vec::new(); self.smallest_first.len()];
        for triangle in &self.mesh.triangles {
            let label = self.found.labels[triangle[0] as usize];
            if let Some(&Some(place)) = places.get(label as usize) {
                triangles[place].push(*triangle);
            }
        }
        triangles
    }

    /// A piece as the report tells it.
    fn describe(&self, piece: u32) -> Option<UnrequiredPiece> {
        let vertices = self.mesh.vertices.iter().zip(&self.found.labels);
        let vertices: Vec<Point3<f32>> = vertices
            .filter(|(_, label)| **label == piece)
            .map(|(vertex, _)| *vertex)
            .collect();
        Some(UnrequiredPiece {
            volume: self.volumes[piece as usize].max(0.0),
            bounds: bounding_box(&vertices)?.map(|corner| corner.into()),
        })
    }
}

/// Whether a silhouette reaches the edge of the picture.
fn is_cut(cone: &Cone) -> bool {
    let level = cone.level();
    let last = level.height() - 1;
    let is_object = |value: &u8| *value >= IS_SET;
    let ends = |y: usize| [level.row(y).first(), level.row(y).last()];
    [0, last]
        .iter()
        .any(|&y| level.row(y).iter().any(is_object))
        || (0..=last).any(|y| ends(y).into_iter().flatten().any(is_object))
}

/// Whether a point is in a camera's picture.
fn is_framed(cone: &Cone, p: Point3<f64>) -> bool {
    let projected = cone.camera().project(p);
    projected.is_some_and(|(pixel, _)| cone.camera().intrinsics.contains(pixel))
}

/// For each piece the middle of its vertices beside other pieces; `None` where it is closed.
fn borders(surface: &Mesh, found: &Components) -> Vec<Option<Vector3<f64>>> {
    let mut sums: Vec<(Vector3<f64>, f64)> = vec![(Vector3::zeros(), 0.0); found.parts.len()];
    for triangle in &surface.triangles {
        let labels = triangle.map(|v| found.labels[v as usize]);
        if labels[0] == labels[1] && labels[1] == labels[2] {
            continue;
        }
        for (vertex, label) in triangle.iter().zip(labels) {
            if let Some((sum, count)) = sums.get_mut(label as usize) {
                *sum += surface.vertices[*vertex as usize].coords.cast::<f64>();
                *count += 1.0;
            }
        }
    }
    let middle = |(sum, count): (Vector3<f64>, f64)| (count > 0.0).then(|| sum / count);
    sums.into_iter().map(middle).collect()
}

/// The volume of each piece in cubic metres, closed by triangles to the middle of its border: a frame's edge is a
/// plane.
fn volumes(mesh: &Mesh, found: &Components, borders: &[Option<Vector3<f64>>]) -> Vec<f64> {
    let mut volumes = vec![0.0; found.parts.len()];
    for (index, triangle) in mesh.triangles.iter().enumerate() {
        let piece = found.labels[triangle[0] as usize] as usize;
        if let (Some(volume), Some(border)) = (volumes.get_mut(piece), borders.get(piece)) {
            let middle = border.unwrap_or_default();
            let [a, b, c] = mesh.corners(index).map(|p| p.coords.cast::<f64>() - middle);
            *volume += a.dot(&b.cross(&c)) / 6.0;
        }
    }
    volumes
}

/// For each piece, given by its triangles, the cells of a camera's silhouette that it covers.
fn covered(cone: &Cone, vertices: &[Point3<f32>], pieces: &[Vec<[u32; 3]>]) -> Vec<Vec<usize>> {
    let camera = cone.camera();
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let cell_px = (width.max(height) as f32 / CELLS).max(1.0);
    let cells_along = |side: usize| ((side as f32 / cell_px) as usize).max(1);
    let (columns, rows) = (cells_along(width), cells_along(height));
    let project = |&vertex: &Point3<f32>| {
        let [x, y, depth] = camera.project_for_raster(vertex);
        let in_cells = |pixel: f32| (pixel + 0.5) / cell_px - 0.5;
        [in_cells(x), in_cells(y), depth]
    };
    let projected: Vec<[f32; 3]> = vertices.iter().map(project).collect();
    let middle = |cell: usize, side: usize| {
        let pixel = ((cell as f32 + 0.5) * cell_px) as usize;
        pixel.min(side - 1)
    };
    let is_object = |column: usize, row: usize| {
        let pixel = (middle(column, width), middle(row, height));
        let is_known = cone.unknown().is_none_or(|unknown| unknown[pixel] < IS_SET);
        is_known && cone.level()[pixel] >= IS_SET
    };
    let cells_of = |triangles: &Vec<[u32; 3]>| {
        let drawn = rasterize(&projected, triangles, columns, rows);
        let is_covered = |&cell: &usize| {
            let (column, row) = (cell % columns, cell / columns);
            drawn[(column, row)].is_covered() && is_object(column, row)
        };
        (0..columns * rows).filter(is_covered).collect()
    };
    pieces.iter().map(cells_of).collect()
}

/// What the pieces cover of one camera's silhouette.
struct Picture {
    /// For each piece the cells that it covers.
    cells: Vec<Vec<usize>>,
    /// For each cell how many pieces cover it.
    pieces: Vec<u32>,
}

impl Picture {
    fn new(cells: Vec<Vec<usize>>) -> Self {
        let last = cells.iter().flatten().max().copied();
        let mut pieces = vec![0; last.map_or(0, |last| last + 1)];
        cells.iter().flatten().for_each(|&cell| pieces[cell] += 1);
        Self { cells, pieces }
    }

    /// Whether a part of the silhouette has no other explanation than a piece.
    fn requires(&self, piece: usize) -> bool {
        let cells = &self.cells[piece];
        let alone = cells.iter().filter(|&&cell| self.pieces[cell] == 1).count();
        alone as f64 > LEAST_ALONE * cells.len() as f64
    }

    fn leave_out(&mut self, piece: usize) {
        for &cell in &self.cells[piece] {
            self.pieces[cell] -= 1;
        }
    }
}

/// The pieces that no picture requires, in ascending order, each without those that were found before it: what is left
/// explains all silhouettes. `is_read` tells for each piece whether a reading requires it.
fn unrequired(mut pictures: Vec<Picture>, is_read: &[bool]) -> Vec<usize> {
    let mut found = Vec::new();
    for (piece, is_read) in is_read.iter().enumerate() {
        let is_required = |picture: &Picture| picture.requires(piece);
        if *is_read || pictures.iter().any(is_required) {
            continue;
        }
        for picture in &mut pictures {
            picture.leave_out(piece);
        }
        found.push(piece);
    }
    found
}

/// Whether a depth camera read a piece: it has parts that were restored, or readings of its surface.
fn is_read(model: &Model, found: &Components, piece: u32, readings: &[Readings]) -> bool {
    let labels = found.labels.iter().enumerate();
    let vertices: Vec<usize> = labels
        .filter(|(_, label)| **label == piece)
        .map(|(vertex, _)| vertex)
        .collect();
    let was_read = |&&vertex: &&usize| match model.provenance[vertex] {
        Provenance::Restored => true,
        Provenance::Hull => is_read_at(
            model.mesh.vertices[vertex].cast(),
            model.normals[vertex],
            readings,
        ),
        _ => false,
    };
    let read = vertices.iter().filter(was_read).count();
    read as f64 > LEAST_READ * vertices.len() as f64
}

/// Whether a depth camera that a place of the hull faces read the surface there, and not beneath.
fn is_read_at(p: Point3<f64>, normal: Vector3<f32>, readings: &[Readings]) -> bool {
    readings.iter().any(|reading| {
        let to_camera = (reading.camera.camera.center() - p).normalize();
        let faces = normal.cast::<f64>().dot(&to_camera) > FACING;
        faces && beneath(p, normal, std::slice::from_ref(reading)) == Some(0.0)
    })
}

/// Marks the vertices of the pieces of these numbers that lie on the hull as unseen.
fn mark(model: &mut Model, pieces: &Pieces, numbers: &[u32]) {
    let (rest, _) = extract(&pieces.mesh, &pieces.found, |piece| {
        !numbers.contains(&piece)
    });
    let rest = Bvh::new(&rest);
    for (vertex, label) in pieces.found.labels.iter().enumerate() {
        if !numbers.contains(label) || model.provenance[vertex] != Provenance::Hull {
            continue;
        }
        model.provenance[vertex] = Provenance::Unseen;
        if let Some(nearest) = rest.closest_point(model.mesh.vertices[vertex].cast()) {
            let error = &mut model.expected_error[vertex];
            *error = error.max((OF_WAY * nearest.distance) as f32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{Camera, Distortion, Intrinsics};
    use crate::frame::CameraId;
    use crate::image::Grid;
    use crate::mesh::{shapes, vertex_normals};
    use nalgebra::{Isometry3, Vector2};

    fn camera(eye: [f64; 3], target: [f64; 3]) -> Camera {
        let (focal, middle) = (Vector2::repeat(300.0), Vector2::repeat(99.5));
        let lens = Intrinsics::new(200, 200, focal, middle, Distortion::default());
        let (eye, target) = (Point3::from(eye), Point3::from(target));
        let pose = Isometry3::face_towards(&eye, &target, &-Vector3::z());
        Camera::new(CameraId::new("c00").unwrap(), lens.unwrap(), pose)
    }

    fn ball(radius: f32, y: f32) -> Mesh {
        let mut ball = shapes::sphere(radius, 3);
        ball.vertices.iter_mut().for_each(|v| v.y += y);
        ball
    }

    /// A ball of 30 mm at the origin, and one of 10 mm that is 0.3 m farther along y.
    fn two_balls() -> Model {
        let mut mesh = ball(0.03, 0.0);
        shapes::append(&mut mesh, &ball(0.01, 0.3));
        on_hull(mesh)
    }

    /// A rod of 40 mm across that reaches along y from -20 to 300 mm, as round at its ends as an egg.
    fn rod() -> Model {
        let mut mesh = shapes::sphere(1.0, 5);
        for v in &mut mesh.vertices {
            *v = Point3::new(0.02 * v.x, 0.14 + 0.16 * v.y, 0.02 * v.z);
        }
        on_hull(mesh)
    }

    fn on_hull(mesh: Mesh) -> Model {
        let count = mesh.vertices.len();
        Model {
            normals: vertex_normals(&mesh),
            provenance: vec![Provenance::Hull; count],
            expected_error: vec![1e-4; count],
            mesh,
            ..Model::default()
        }
    }

    /// What is found in a model by cameras in whose pictures all is object.
    fn marked(model: &mut Model, cameras: &[Camera]) -> Vec<UnrequiredPiece> {
        let level = Grid::filled(200, 200, 255);
        let cones: Vec<Cone> = cameras.iter().map(|c| Cone::new(c, &level)).collect();
        mark_unrequired(model, &cones, &[])
    }

    /// Behind the ball for the first of them, beyond the frame of the second.
    fn blind() -> [Camera; 2] {
        [[0.0, -0.5, 0.0], [0.5, 0.0, 0.0]].map(|eye| camera(eye, [0.0; 3]))
    }

    #[test]
    fn a_piece_that_other_pieces_hide_or_frames_leave_out_is_marked_and_stays() {
        let mut model = two_balls();
        let before = model.mesh.clone();
        let found = marked(&mut model, &blind());
        assert_eq!(model.mesh, before);
        let [piece] = found.as_slice() else {
            panic!("one piece: {found:?}");
        };
        let volume = 4.0 / 3.0 * std::f64::consts::PI * 0.01_f64.powi(3);
        assert!((piece.volume / volume - 1.0).abs() < 0.05, "{piece:?}");
        let [low, high] = piece.bounds;
        assert!(low[1] > 0.28 && high[1] < 0.32, "{piece:?}");
        for (vertex, p) in model.mesh.vertices.iter().enumerate() {
            let error = model.expected_error[vertex];
            if p.y > 0.2 {
                assert_eq!(model.provenance[vertex], Provenance::Unseen);
                // Half of the way to the other ball.
                assert!((0.129..0.141).contains(&error), "{error}");
            } else {
                assert_eq!(model.provenance[vertex], Provenance::Hull);
                assert_eq!(error, 1e-4);
            }
        }
    }

    #[test]
    fn a_piece_is_required_where_one_camera_sees_it_alone_or_a_depth_camera_read_it() {
        let seen = camera([0.5, 0.3, 0.0], [0.0, 0.3, 0.0]);
        let [a, b] = blind();
        assert!(marked(&mut two_balls(), &[a, b, seen]).is_empty());
        let mut read = two_balls();
        for (provenance, p) in read.provenance.iter_mut().zip(&read.mesh.vertices) {
            if p.y > 0.2 {
                *provenance = Provenance::Restored;
            }
        }
        assert!(marked(&mut read, &blind()).is_empty());
        let mut alone = two_balls();
        alone.mesh = ball(0.03, 0.0);
        assert!(marked(&mut alone, &blind()).is_empty());
    }

    #[test]
    fn what_grows_out_of_the_object_beyond_a_frame_is_a_piece_of_its_own() {
        let mut model = rod();
        let found = marked(&mut model, &blind());
        let [piece] = found.as_slice() else {
            panic!("one piece: {found:?}");
        };
        // The frame of the second camera ends at 0.16 m in front and at 0.17 m behind.
        let across = |t: f64| t - t.powi(3) / (3.0 * 0.16_f64.powi(2));
        let volume = std::f64::consts::PI * 0.02_f64.powi(2) * (across(0.16) - across(0.026));
        assert!((piece.volume / volume - 1.0).abs() < 0.15, "{piece:?}");
        assert!(piece.bounds[0][1] > 0.15 && piece.bounds[1][1] > 0.29);
        for (vertex, p) in model.mesh.vertices.iter().enumerate() {
            match model.provenance[vertex] {
                Provenance::Unseen => assert!(p.y > 0.15),
                _ => assert!(p.y < 0.19, "{p}"),
            }
            if p.y > 0.29 {
                let error = model.expected_error[vertex];
                assert!((0.055..0.075).contains(&error), "{error}");
            }
        }
        let seen = camera([0.5, 0.3, 0.0], [0.0, 0.3, 0.0]);
        let [a, b] = blind();
        assert!(marked(&mut rod(), &[a, b, seen]).is_empty());
    }

    #[test]
    fn of_pieces_that_explain_the_same_the_largest_is_required() {
        let picture = || Picture::new(vec![vec![3, 4], vec![3, 4], vec![3, 4, 5], vec![9]]);
        assert_eq!(unrequired(vec![picture()], &[false; 4]), [0, 1]);
        let two_alike = || Picture::new(vec![vec![3, 4], vec![3, 4]]);
        assert_eq!(unrequired(vec![two_alike()], &[false; 2]), [0]);
        assert_eq!(unrequired(vec![two_alike()], &[true, false]), [1]);
    }
}
