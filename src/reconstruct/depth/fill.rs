//! Filling holes: what depth to give to pixels without a reading.

use crate::image::Grid;

/// Passes of relaxation.
const PASSES: usize = 200;

/// Fills the pixels of `inside` that have no depth (0) with the harmonic function that the depth around
/// them bounds. A pixel that no depth reaches stays 0.
pub fn fill(depth: &Grid<f32>, inside: &Grid<bool>) -> Grid<f32> {
    let mut out = depth.clone();
    let holes: Vec<(usize, usize)> = (0..depth.height())
        .flat_map(|y| (0..depth.width()).map(move |x| (x, y)))
        .filter(|&p| depth[p] <= 0.0 && inside[p])
        .collect();
    for _ in 0..PASSES {
        for &(x, y) in &holes {
            let (mut sum, mut count) = (0.0, 0.0);
            for (dx, dy) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
                if let Some(&z) = out.get(x as isize + dx, y as isize + dy)
                    && z > 0.0
                {
                    sum += z;
                    count += 1.0;
                }
            }
            if count > 0.0 {
                out[(x, y)] = sum / count;
            }
        }
    }
    out
}
