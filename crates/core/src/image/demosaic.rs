//! Turns a Bayer mosaic into colours by gradient-corrected linear interpolation (Malvar, He and Cutler, "High-quality
//! linear interpolation for demosaicing of Bayer-patterned color images", ICASSP 2004).
//!
//! A missing colour is the mean of its neighbours corrected by the second derivative of the colour that is
//! there, so that edges stay where they are. In a row, columns of one parity hold red or blue (the row's
//! primary) and those of the other hold green; both kinds are computed on arrays of their own, which the
//! compiler turns into vector code.

use super::{Grid, RgbImage};
use rayon::prelude::*;

/// Which colour is at which place of the mosaic's 2 x 2 cell, by the place of red.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BayerOrder {
    /// Column of red, 0 or 1.
    pub red_x: usize,
    /// Row of red, 0 or 1.
    pub red_y: usize,
}

impl BayerOrder {
    /// Red green, green blue.
    pub const RGGB: Self = Self { red_x: 0, red_y: 0 };
    /// Green red, blue green.
    pub const GRBG: Self = Self { red_x: 1, red_y: 0 };
    /// Green blue, red green.
    pub const GBRG: Self = Self { red_x: 0, red_y: 1 };
    /// Blue green, green red.
    pub const BGGR: Self = Self { red_x: 1, red_y: 1 };
}

/// Rows that one task computes.
const BAND: usize = 32;

/// Interpolates the two colours that each pixel of `mosaic` lacks. `mosaic` holds `height` rows that begin
/// `step` bytes apart.
///
/// # Panics
/// If `mosaic` is shorter than its rows.
pub fn demosaic(
    width: usize,
    height: usize,
    step: usize,
    mosaic: &[u8],
    order: BayerOrder,
) -> RgbImage {
    let mut pixels = vec![[0u8; 3]; width * height];
    let row = |y: isize| {
        let start = mirrored(y, height) * step;
        &mosaic[start..start + width]
    };
    pixels
        .par_chunks_mut((BAND * width).max(1))
        .enumerate()
        .for_each(|(band, pixels)| {
            let first = (band * BAND) as isize;
            let rows = pixels.len() / width;
            let lines: Vec<Line> = (first - 2..first + rows as isize + 2)
                .map(|y| Line::new(row(y)))
                .collect();
            let mut scratch = Scratch::new(width.div_ceil(2));
            for (i, out) in pixels.chunks_exact_mut(width).enumerate() {
                let window: &[Line; 5] = lines[i..]
                    .first_chunk()
                    .unwrap_or_else(|| unreachable!("two lines above and below every row"));
                let y = first as usize + i;
                interpolate(window, y % 2 == order.red_y, order, &mut scratch, out);
            }
        });
    Grid::from_pixels(width, height, pixels)
}

/// The index, mirrored at the ends so that its parity, and so its colour, stays.
fn mirrored(i: isize, length: usize) -> usize {
    let last = length as isize - 1;
    if last == 0 {
        return 0;
    }
    let mut i = i;
    loop {
        match i {
            _ if i < 0 => i = -i,
            _ if i > last => i = 2 * last - i,
            _ => return i as usize,
        }
    }
}

/// A row, its even and odd columns apart, each with one more at either end. Column 2k is `planes[0][k + 1]`.
struct Line {
    planes: [Vec<i16>; 2],
}

impl Line {
    fn new(row: &[u8]) -> Self {
        let pairs = row.len().div_ceil(2);
        let mut even = vec![0i16; pairs + 2];
        let mut odd = vec![0i16; pairs + 2];
        let (whole, _) = row.as_chunks::<2>();
        for ((&[a, b], even), odd) in whole.iter().zip(&mut even[1..]).zip(&mut odd[1..]) {
            *even = i16::from(a);
            *odd = i16::from(b);
        }
        let at = |x: isize| i16::from(row[mirrored(x, row.len())]);
        (even[0], odd[0]) = (at(-2), at(-1));
        for pair in [pairs - 1, pairs] {
            let x = 2 * pair as isize;
            (even[pair + 1], odd[pair + 1]) = (at(x), at(x + 1));
        }
        Self {
            planes: [even, odd],
        }
    }
}

/// The interpolated values of one row, a value for each pair of columns.
struct Scratch {
    /// Green where the primary is.
    green: Vec<u8>,
    /// The other of red and blue where the primary is.
    diagonal: Vec<u8>,
    /// The primary where green is: its neighbours are left and right.
    horizontal: Vec<u8>,
    /// The other where green is: its neighbours are above and below.
    vertical: Vec<u8>,
}

impl Scratch {
    fn new(pairs: usize) -> Self {
        let zeros = || vec![0; pairs];
        Self {
            green: zeros(),
            diagonal: zeros(),
            horizontal: zeros(),
            vertical: zeros(),
        }
    }
}

/// Computes a row of colours. `lines` are the rows from two above to two below; `has_red` tells a row of
/// red and green from one of blue and green.
fn interpolate(
    lines: &[Line; 5],
    has_red: bool,
    order: BayerOrder,
    scratch: &mut Scratch,
    out: &mut [[u8; 3]],
) {
    let primary = if has_red {
        order.red_x
    } else {
        1 - order.red_x
    };
    at_primary(lines, primary, scratch);
    at_green(lines, 1 - primary, scratch);
    let pairs = scratch.green.len();
    let center = |plane: usize| &lines[2].planes[plane][1..=pairs];
    let s = scratch;
    let measured = center(primary).iter().zip(center(1 - primary));
    let first = s.green.iter().zip(&s.diagonal);
    let second = s.horizontal.iter().zip(&s.vertical);
    let mut pixel_pairs = out.chunks_mut(2);
    for (((&p, &g), (&green, &diagonal)), (&horizontal, &vertical)) in
        measured.zip(first).zip(second)
    {
        let mut at_primary = [p as u8, green, diagonal];
        let mut at_green = [horizontal, g as u8, vertical];
        if !has_red {
            at_primary.reverse();
            at_green.reverse();
        }
        let both = if primary == 0 {
            [at_primary, at_green]
        } else {
            [at_green, at_primary]
        };
        match pixel_pairs.next() {
            Some([a, b]) => [*a, *b] = both,
            Some([a]) => *a = both[0],
            _ => {}
        }
    }
}

/// Sixteenths to a pixel's value.
#[inline(always)]
fn rounded(sixteenths: i16) -> u8 {
    ((sixteenths + 8) >> 4).clamp(0, 255) as u8
}

/// The slices of `plane` that lie `by` pairs to the right of each pair of columns.
#[inline(always)]
fn shifted(line: &Line, plane: usize, by: isize, pairs: usize) -> &[i16] {
    let start = (1 + by) as usize;
    &line.planes[plane][start..start + pairs]
}

/// Where the columns left of a plane's are in the other plane: for even columns a pair before.
fn west(plane: usize) -> isize {
    plane as isize - 1
}

/// The pixels of a plane in a row and those around them, each as a slice with one value a pair of columns.
struct Neighborhood<'a> {
    center: &'a [i16],
    /// Two pixels above, below, to the left and to the right.
    far: [&'a [i16]; 4],
    /// Above, below, to the left and to the right.
    beside: [&'a [i16]; 4],
    /// The four at the corners.
    corners: [&'a [i16]; 4],
}

impl<'a> Neighborhood<'a> {
    /// Around the pixels of `plane` in the third of five rows.
    #[inline(always)]
    fn new(lines: &'a [Line; 5], plane: usize, n: usize) -> Self {
        let (other, w) = (1 - plane, west(plane));
        let [far_north, north, center, south, far_south] = lines;
        let here = |line, by| shifted(line, plane, by, n);
        let west = |line| shifted(line, other, w, n);
        let east = |line| shifted(line, other, w + 1, n);
        Self {
            center: here(center, 0),
            far: [
                here(far_north, 0),
                here(far_south, 0),
                here(center, -1),
                here(center, 1),
            ],
            beside: [here(north, 0), here(south, 0), west(center), east(center)],
            corners: [west(north), east(north), west(south), east(south)],
        }
    }
}

/// Green and the diagonal colour where the row's primary is (Fig. 2, first and last filter of the paper).
fn at_primary(lines: &[Line; 5], plane: usize, out: &mut Scratch) {
    let n = out.green.len();
    let around = Neighborhood::new(lines, plane, n);
    let (c, [u, d, l, r]) = (around.center, around.far);
    let ([gn, gs, gw, ge], [nw, ne, sw, se]) = (around.beside, around.corners);
    let (green, diagonal) = (&mut out.green[..n], &mut out.diagonal[..n]);
    for i in 0..n {
        let far = u[i] + d[i] + l[i] + r[i];
        let crossing = gn[i] + gs[i] + gw[i] + ge[i];
        let corners = nw[i] + ne[i] + sw[i] + se[i];
        green[i] = rounded(8 * c[i] + 4 * crossing - 2 * far);
        diagonal[i] = rounded(12 * c[i] + 4 * corners - 3 * far);
    }
}

/// The row's primary and the other colour where green is (Fig. 2, second and third filter of the paper).
fn at_green(lines: &[Line; 5], plane: usize, out: &mut Scratch) {
    let n = out.green.len();
    let around = Neighborhood::new(lines, plane, n);
    let (c, [u, d, l, r]) = (around.center, around.far);
    let ([vn, vs, hw, he], [nw, ne, sw, se]) = (around.beside, around.corners);
    let (horizontal, vertical) = (&mut out.horizontal[..n], &mut out.vertical[..n]);
    for i in 0..n {
        let (row, column) = (l[i] + r[i], u[i] + d[i]);
        let corners = nw[i] + ne[i] + sw[i] + se[i];
        horizontal[i] = rounded(10 * c[i] + 8 * (hw[i] + he[i]) - 2 * (row + corners) + column);
        vertical[i] = rounded(10 * c[i] + 8 * (vn[i] + vs[i]) - 2 * (column + corners) + row);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ORDERS: [BayerOrder; 4] = [
        BayerOrder::RGGB,
        BayerOrder::GRBG,
        BayerOrder::GBRG,
        BayerOrder::BGGR,
    ];

    fn mosaic_of(picture: &RgbImage, order: BayerOrder, step: usize) -> Vec<u8> {
        let mut bytes = vec![0xee; step * picture.height()];
        for y in 0..picture.height() {
            for x in 0..picture.width() {
                let channel = match (x % 2 == order.red_x, y % 2 == order.red_y) {
                    (true, true) => 0,
                    (false, false) => 2,
                    _ => 1,
                };
                bytes[y * step + x] = picture[(x, y)][channel];
            }
        }
        bytes
    }

    #[test]
    fn a_flat_colour_comes_back_in_every_order_and_size() {
        for order in ORDERS {
            for (w, h) in [(2, 2), (3, 3), (4, 2), (5, 7), (64, 33), (33, 70)] {
                let picture = Grid::filled(w, h, [200, 100, 50]);
                let bytes = mosaic_of(&picture, order, w + 3);
                assert_eq!(
                    demosaic(w, h, w + 3, &bytes, order),
                    picture,
                    "{order:?} {w}x{h}"
                );
            }
        }
    }

    #[test]
    fn a_single_pixel_or_line_does_not_panic() {
        for (w, h) in [(1, 1), (1, 9), (9, 1)] {
            demosaic(w, h, w, &vec![7; w * h], BayerOrder::RGGB);
        }
    }

    #[test]
    fn a_slope_is_kept_to_rounding() {
        let picture = Grid::from_fn(60, 50, |x, y| {
            [(x + y) as u8, (20 + 2 * x) as u8, (10 + x + 2 * y) as u8]
        });
        for order in ORDERS {
            let back = demosaic(60, 50, 60, &mosaic_of(&picture, order, 60), order);
            for y in 3..47 {
                for x in 3..57 {
                    for c in 0..3 {
                        assert!(back[(x, y)][c].abs_diff(picture[(x, y)][c]) <= 1);
                    }
                }
            }
        }
    }

    #[test]
    fn a_grey_edge_is_sharper_than_bilinear() {
        // A slanted edge between greys: bilinear interpolation blurs it and adds colour.
        let picture = Grid::from_fn(
            64,
            64,
            |x, y| if 3 * x + y > 120 { [220; 3] } else { [40; 3] },
        );
        let order = BayerOrder::RGGB;
        let bytes = mosaic_of(&picture, order, 64);
        let ours = demosaic(64, 64, 64, &bytes, order);
        let bilinear_green = |x: usize, y: usize| {
            if (x + y) % 2 == 1 {
                return f64::from(bytes[y * 64 + x]);
            }
            let near = [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)];
            near.iter()
                .map(|&(x, y)| f64::from(bytes[y * 64 + x]))
                .sum::<f64>()
                / 4.0
        };
        let (mut error, mut bilinear_error) = (0.0, 0.0);
        for y in 2..62 {
            for x in 2..62 {
                let truth = f64::from(picture[(x, y)][1]);
                error += (f64::from(ours[(x, y)][1]) - truth).powi(2);
                bilinear_error += (bilinear_green(x, y) - truth).powi(2);
            }
        }
        assert!(error < 0.5 * bilinear_error, "{error} {bilinear_error}");
    }
}
