//! Keeps a wall between two surfaces that depth cameras read from opposite sides. Each reading may be too deep by its
//! noise, so that two surfaces of a thin wall can pass each other, and both carvings together would perforate it.

use super::{Parameters, Source};
use crate::image::Grid;
use crate::reconstruct::hull::Carving;
use nalgebra::{Point2, Point3};

/// Largest cosine between the normals of a wall's two sides.
const OPPOSITE: f64 = -0.5;
/// Standard errors by which two sides may pass each other for noise alone; beyond that, there is no wall.
const NOISE: f64 = 3.0;
/// A surface seen at less than this cosine is taken as seen at it.
const GRAZING: f64 = 0.2;

/// Moves the surfaces of opposite carvings apart where less than the thinnest wall is between them, unless they pass
/// each other by more than they may be off. Each side moves by half of what is missing. `depths` belong to `sources`.
pub(super) fn keep_between(
    depths: &mut [Grid<f32>],
    sources: &[Source],
    cell_size: f64,
    parameters: &Parameters,
) {
    if sources.len() < 2 {
        return;
    }
    let wall = f64::from(1e-3 * parameters.least_wall_mm).max(0.75 * cell_size);
    let pairs = sources.iter().zip(&*depths);
    let carvings: Vec<Carving> = pairs
        .map(|(source, depth)| Carving::new(source.camera, depth.clone(), cell_size))
        .collect();
    for (own, depth) in depths.iter_mut().enumerate() {
        let exit = &sources[own].regions.front.exit;
        *depth = Grid::from_fn_parallel(depth.width(), depth.height(), |x, y| {
            let carved = depth[(x, y)];
            // What breaks through leaves no wall on purpose.
            if carved == 0.0 || carved > exit[(x, y)] {
                return carved;
            }
            let pixel = Point2::new(x as f64, y as f64);
            let missing = missing(sources, &carvings, own, pixel, wall);
            carved - missing as f32
        });
    }
}

/// How much nearer, in metres of depth, a pixel's surface has to be for half of the wall to stand before it.
fn missing(
    sources: &[Source],
    carvings: &[Carving],
    own: usize,
    pixel: Point2<f64>,
    wall: f64,
) -> f64 {
    let found = || {
        let carving = &carvings[own];
        let p = carving.camera().point(pixel, carving.depth_at(pixel)?)?;
        let normal = carving.normal(p)?;
        let sides = (0..carvings.len()).filter(|other| *other != own);
        let lacking = sides.filter_map(|other| {
            let theirs = &carvings[other];
            let opposite = theirs.normal(p)?;
            let thickness = -theirs.carved_depth(p)? * across(theirs, p, &opposite);
            let doubt = NOISE * noise(&sources[own], p)?.hypot(noise(&sources[other], p)?)
                + sources[own].regions.bias.remaining
                + sources[other].regions.bias.remaining;
            (normal.dot(&opposite) < OPPOSITE && thickness > -doubt)
                .then_some(0.5 * (wall - thickness))
        });
        let most = lacking.fold(0.0, f64::max);
        Some(most / across(carving, p, &normal))
    };
    found().unwrap_or(0.0)
}

/// Metres across a surface for each metre of depth along the view of a point of it.
fn across(carving: &Carving, p: Point3<f64>, normal: &nalgebra::Vector3<f64>) -> f64 {
    let camera = &carving.camera().camera;
    let towards = camera.center() - p;
    let facing = normal.dot(&towards.normalize()).max(GRAZING);
    facing * towards.norm() / camera.camera_from_rig(p).z.max(1e-3)
}

/// Standard error of a camera's depth at a point.
fn noise(source: &Source, p: Point3<f64>) -> Option<f64> {
    let (pixel, _) = source.camera.project(p)?;
    let at = (pixel.x.round() as isize, pixel.y.round() as isize);
    source.depth.sigma.get(at.0, at.1).map(|s| f64::from(*s))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruct::restore::testing::{SIDE, camera, evidence};

    /// How thick the wall between two cameras 1.6 m apart is, if it was read this thick.
    fn kept(thickness: f32) -> f32 {
        let read = 0.8 - 0.5 * thickness;
        let cameras = [camera(0.8), camera(-0.8)];
        let evidence = [evidence(read), evidence(read)];
        let sources = [0, 1].map(|i| Source {
            number: i,
            camera: &cameras[i],
            depth: &evidence[i].0,
            regions: &evidence[i].1,
        });
        let mut depths = [0, 1].map(|_| Grid::filled(SIDE, SIDE, read));
        keep_between(&mut depths, &sources, 0.5e-3, &Parameters::default());
        let at = (SIDE / 2, SIDE / 2);
        1.6 - depths[0][at] - depths[1][at]
    }

    #[test]
    fn two_sides_that_pass_each_other_for_noise_leave_a_wall() {
        for read in [-3e-3, -0.5e-3, 0.0, 1e-3] {
            assert!((kept(read) - 2e-3).abs() < 1e-5, "{read}: {}", kept(read));
        }
    }

    #[test]
    fn a_thicker_wall_and_a_clear_opening_stay_as_they_were_read() {
        for read in [2.5e-3, 10e-3, -8e-3] {
            assert!((kept(read) - read).abs() < 1e-5, "{read}: {}", kept(read));
        }
    }
}
