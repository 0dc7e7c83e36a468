//! Packs shapes made of square cells into a strip of given width: the largest first, each in the form that ends first,
//! as low as that goes and there as far left, into bays that others leave. Slower than packing rectangles, and denser
//! where shapes are not rectangles.

use std::cmp::Reverse;
use std::ops::Range;

/// A shape: for each row of cells the runs of those that it takes, from the left.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CellShape {
    rows: Vec<Vec<Range<usize>>>,
}

impl CellShape {
    /// A shape of rows, each a list of runs in any order, which may overlap.
    pub fn new(mut rows: Vec<Vec<Range<usize>>>) -> Self {
        for row in &mut rows {
            row.retain(|run| !run.is_empty());
            row.sort_by_key(|run| run.start);
            row.dedup_by(|later, run| {
                let touches = later.start <= run.end;
                if touches {
                    run.end = run.end.max(later.end);
                }
                touches
            });
        }
        Self { rows }
    }

    /// How many cells it takes.
    pub fn area(&self) -> usize {
        self.rows.iter().flatten().map(Range::len).sum()
    }

    /// Cells from the left to where its rightmost run ends.
    pub fn width(&self) -> usize {
        self.rows
            .iter()
            .flatten()
            .map(|run| run.end)
            .max()
            .unwrap_or(0)
    }

    /// Its rows.
    pub fn height(&self) -> usize {
        self.rows.len()
    }
}

/// By what the largest shape comes first. None is best for all sets of shapes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PackingOrder {
    /// Rows.
    Height,
    /// Cells.
    Area,
    /// Rows and columns together.
    Extent,
}

impl PackingOrder {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Height, Self::Area, Self::Extent];

    fn size(self, shape: &CellShape) -> (usize, usize) {
        let area = shape.area();
        match self {
            Self::Height => (shape.height(), area),
            Self::Area => (area, shape.height()),
            Self::Extent => (shape.height() + shape.width(), area),
        }
    }
}

/// Where a shape lies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlacedShape {
    /// Which of its forms was taken.
    pub form: usize,
    /// Column and row of the top left cell.
    pub place: [usize; 2],
}

/// Where each shape lies in a strip of `width` cells, and how many rows the strip gets. Each shape is given in the
/// forms that it may take, such as upright and turned. `None` if no form of a shape fits into the strip, or the strip
/// would be higher than `highest`. The result depends on the arguments alone.
pub fn pack_shapes<const FORMS: usize>(
    shapes: &[[CellShape; FORMS]],
    by: PackingOrder,
    width: usize,
    highest: usize,
) -> Option<(Vec<PlacedShape>, usize)> {
    // The flattest form is the one that mostly ends first.
    let size = |forms: &[CellShape; FORMS]| forms.iter().map(|shape| by.size(shape)).min();
    let sizes: Vec<_> = shapes.iter().map(size).collect();
    let mut order: Vec<usize> = (0..shapes.len()).collect();
    order.sort_by_key(|&i| (Reverse(sizes[i]), i));
    let mut strip = Strip::new(width);
    let mut places = vec![PlacedShape::default(); shapes.len()];
    for index in order {
        places[index] = strip.place(&shapes[index], highest)?;
    }
    Some((places, strip.height()))
}

/// Bits of a word.
const BITS: usize = u64::BITS as usize;

/// The cells that are taken, a bit each.
struct Strip {
    width: usize,
    /// Words of a row.
    words: usize,
    taken: Vec<Vec<u64>>,
    /// The first row that is not full.
    first: usize,
}

impl Strip {
    fn new(width: usize) -> Self {
        Self {
            width,
            words: width.div_ceil(BITS),
            taken: Vec::new(),
            first: 0,
        }
    }

    fn height(&self) -> usize {
        self.taken.len()
    }

    /// Places the form of a shape that ends first, the first of equals.
    fn place(&mut self, forms: &[CellShape], highest: usize) -> Option<PlacedShape> {
        let mut best: Option<(usize, PlacedShape)> = None;
        for (form, shape) in forms.iter().enumerate() {
            let most = best.map_or(highest, |(end, _)| end.saturating_sub(1));
            if let Some(place) = self.first_place(shape, most) {
                best = Some((place[1] + shape.height(), PlacedShape { form, place }));
            }
        }
        let (_, placed) = best?;
        self.take(&forms[placed.form], placed.place);
        Some(placed)
    }

    /// The first place of a shape, row by row, at which it ends within `highest` rows.
    fn first_place(&self, shape: &CellShape, highest: usize) -> Option<[usize; 2]> {
        let columns = (self.width + 1).checked_sub(shape.width().max(1))?;
        let last = highest.checked_sub(shape.height())?;
        (self.first..=last).find_map(|row| Some([self.leftmost(shape, row, columns)?, row]))
    }

    /// The leftmost of the first `columns` columns in which a shape fits at a row.
    fn leftmost(&self, shape: &CellShape, row: usize, columns: usize) -> Option<usize> {
        let mut blocked = vec![0; self.words];
        blocked.iter_mut().enumerate().for_each(|(i, word)| {
            let open = columns.saturating_sub(i * BITS).min(BITS);
            *word = if open == BITS { 0 } else { u64::MAX << open };
        });
        let below = self.taken.get(row..).unwrap_or_default();
        let mut any = Vec::with_capacity(self.words);
        for (taken, runs) in below.iter().zip(&shape.rows) {
            for run in runs {
                block(&mut blocked, taken, run, &mut any);
            }
            if blocked.iter().all(|&word| word == u64::MAX) {
                return None;
            }
        }
        let word = blocked.iter().position(|&word| word != u64::MAX)?;
        Some(word * BITS + blocked[word].trailing_ones() as usize)
    }

    fn take(&mut self, shape: &CellShape, [left, top]: [usize; 2]) {
        let rows = self.height().max(top + shape.height());
        self.taken.resize(rows, vec![0; self.words]);
        for (taken, runs) in self.taken[top..].iter_mut().zip(&shape.rows) {
            for column in runs.iter().flat_map(|run| run.start + left..run.end + left) {
                taken[column / BITS] |= 1 << (column % BITS);
            }
        }
        let (width, full) = (self.width, |row: &[u64]| {
            row.iter().map(|w| w.count_ones() as usize).sum::<usize>()
        });
        while self
            .taken
            .get(self.first)
            .is_some_and(|row| full(row) == width)
        {
            self.first += 1;
        }
    }
}

/// Marks the columns from which a run would meet a cell that is taken. `any` is room for a row, whatever it holds.
fn block(blocked: &mut [u64], taken: &[u64], run: &Range<usize>, any: &mut Vec<u64>) {
    any.clear();
    any.extend((0..taken.len()).map(|i| shifted_word(taken, i, run.start)));
    // Each step doubles how many columns to the right a bit answers for.
    let mut covered = 1;
    while covered < run.len() {
        let step = covered.min(run.len() - covered);
        // What lies to the right is not changed yet.
        for i in 0..any.len() {
            let more = shifted_word(any, i, step);
            any[i] |= more;
        }
        covered += step;
    }
    blocked.iter_mut().zip(&*any).for_each(|(b, a)| *b |= a);
}

/// A word of a row that was moved to the left by this many columns.
fn shifted_word(row: &[u64], index: usize, by: usize) -> u64 {
    let (words, bits) = (by / BITS, by % BITS);
    let word = |i: usize| row.get(i).copied().unwrap_or(0);
    match bits {
        0 => word(index + words),
        _ => word(index + words) >> bits | word(index + words + 1) << (BITS - bits),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::HashSet;

    fn cells(shape: &CellShape, [left, top]: [usize; 2]) -> Vec<[usize; 2]> {
        let rows = shape.rows.iter().enumerate();
        let of_row = |(y, runs): (usize, &Vec<Range<usize>>)| {
            let columns: Vec<usize> = runs.iter().cloned().flatten().collect();
            columns.into_iter().map(move |x| [x + left, y + top])
        };
        rows.flat_map(of_row).collect()
    }

    fn rows() -> impl Strategy<Value = Vec<Vec<Range<usize>>>> {
        let run = (0..60_usize, 0..60_usize).prop_map(|(a, b)| a.min(b)..a.max(b));
        prop::collection::vec(prop::collection::vec(run, 0..4), 1..12)
    }

    proptest! {
        #[test]
        fn shapes_lie_in_the_strip_and_apart(shapes in prop::collection::vec(rows(), 1..40), width in 60..200_usize, by in 0..3_usize) {
            let turned = |shape: &CellShape| {
                let cells = cells(shape, [0, 0]);
                let row = |x: usize| -> Vec<Range<usize>> {
                    let column = cells.iter().filter(|cell| cell[0] == x);
                    column.map(|cell| cell[1]..cell[1] + 1).collect()
                };
                CellShape::new((0..shape.width()).map(row).collect())
            };
            let shapes = shapes.into_iter().map(CellShape::new);
            let shapes: Vec<_> = shapes.map(|shape| [shape.clone(), turned(&shape)]).collect();
            let by = PackingOrder::ALL[by];
            let (places, height) = pack_shapes(&shapes, by, width, usize::MAX).unwrap();
            let mut taken = HashSet::new();
            let forms = shapes.iter().zip(places);
            for cell in forms.flat_map(|(s, placed)| cells(&s[placed.form], placed.place)) {
                prop_assert!(cell[0] < width && cell[1] < height, "{cell:?}");
                prop_assert!(taken.insert(cell), "{cell:?} is taken twice");
            }
        }
    }

    /// Shapes that have one form, packed.
    fn packed(
        shapes: &[CellShape],
        width: usize,
        highest: usize,
    ) -> Option<(Vec<[usize; 2]>, usize)> {
        let shapes: Vec<_> = shapes.iter().map(|shape| [shape.clone()]).collect();
        let (placed, height) = pack_shapes(&shapes, PackingOrder::Height, width, highest)?;
        Some((placed.iter().map(|placed| placed.place).collect(), height))
    }

    #[test]
    fn a_shape_lies_in_the_bay_of_another() {
        let bay = CellShape::new(vec![vec![0..10], vec![0..2, 8..10], vec![0..10]]);
        let bar = CellShape::new(vec![vec![0..6]]);
        let found = packed(&[bar, bay], 10, 3);
        assert_eq!(found, Some((vec![[2, 1], [0, 0]], 3)));
    }

    #[test]
    fn a_shape_is_turned_where_it_ends_sooner() {
        let lying = |length| CellShape::new(vec![vec![0..length]]);
        let standing = |length| CellShape::new(vec![vec![0..1]; length]);
        // A block with a shaft at its right: the bar stands in it, and another lies beneath.
        let block = CellShape::new(vec![vec![0..5]; 4]);
        let shapes = [
            [block.clone(), block],
            [lying(4), standing(4)],
            [standing(6), lying(6)],
        ];
        let (placed, height) = pack_shapes(&shapes, PackingOrder::Area, 6, 9).unwrap();
        let placed: Vec<_> = placed.iter().map(|p| (p.form, p.place)).collect();
        assert_eq!(placed, [(0, [0, 0]), (1, [5, 0]), (1, [0, 4])]);
        assert_eq!(height, 5);
        // What fits in no other way is turned, too.
        let wide = [[lying(4), standing(4)]];
        let (placed, height) = pack_shapes(&wide, PackingOrder::Area, 3, 4).unwrap();
        assert_eq!((placed[0].form, height), (1, 4));
    }

    #[test]
    fn what_is_too_wide_or_too_high_does_not_fit() {
        let square = CellShape::new(vec![vec![0..3]; 3]);
        let shapes = [square.clone(), square];
        assert_eq!(packed(&shapes, 2, 9), None);
        assert_eq!(packed(&shapes, 3, 5), None);
        let found = packed(&shapes, 3, 6);
        assert_eq!(found, Some((vec![[0, 0], [0, 3]], 6)));
        assert_eq!(packed(&[], 2, 0), Some((vec![], 0)));
    }
}
