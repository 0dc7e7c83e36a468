//! Packs rectangles into a strip of given width: the highest first, each as low as it goes (skyline, bottom left;
//! Jylänki 2010).

/// Where each rectangle (width, height) lies in a strip of `width`, and how high the strip becomes; `None`
/// if a rectangle is wider than the strip. The result depends on the sizes alone.
pub fn pack(sizes: &[[usize; 2]], width: usize) -> Option<(Vec<[usize; 2]>, usize)> {
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    order.sort_by_key(|&i| (std::cmp::Reverse((sizes[i][1], sizes[i][0])), i));
    let mut skyline = Skyline {
        steps: vec![SkylineStep { x: 0, y: 0 }],
        width,
    };
    let mut places = vec![[0; 2]; sizes.len()];
    let mut height = 0;
    for index in order {
        let place = skyline.place(sizes[index])?;
        height = height.max(place[1] + sizes[index][1]);
        places[index] = place;
    }
    Some((places, height))
}

/// From `x` to the next step's `x` everything below `y` is taken.
#[derive(Clone, Copy)]
struct SkylineStep {
    x: usize,
    y: usize,
}

struct Skyline {
    steps: Vec<SkylineStep>,
    width: usize,
}

impl Skyline {
    fn place(&mut self, [width, height]: [usize; 2]) -> Option<[usize; 2]> {
        let mut best: Option<(usize, usize)> = None;
        for first in 0..self.steps.len() {
            let lowest = best.map_or(usize::MAX, |(y, _)| y);
            match self.level(first, width, lowest) {
                Some(y) if y < lowest => best = Some((y, first)),
                _ => {}
            }
        }
        let (y, first) = best?;
        let x = self.steps[first].x;
        self.raise(first, x + width, y + height);
        Some([x, y])
    }

    /// How low a rectangle can lie that begins at a step; `None` past the strip's end or above `limit`.
    fn level(&self, first: usize, width: usize, limit: usize) -> Option<usize> {
        let end = self.steps[first].x + width;
        if end > self.width {
            return None;
        }
        let mut y = 0;
        for step in self.steps[first..].iter().take_while(|s| s.x < end) {
            y = y.max(step.y);
            if y >= limit {
                return None;
            }
        }
        Some(y)
    }

    /// Takes everything from a step to `end` below `y`.
    fn raise(&mut self, first: usize, end: usize, y: usize) {
        let covered = self.steps[first..].iter().take_while(|s| s.x < end).count();
        let last = first + covered;
        let after = self.steps[last - 1].y;
        let next = self.steps.get(last).map_or(self.width, |s| s.x);
        self.steps[first].y = y;
        let rest = (next > end).then_some(SkylineStep { x: end, y: after });
        self.steps.splice(first + 1..last, rest);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn rectangles_lie_in_the_strip_and_apart(
            sizes in prop::collection::vec([1..40_usize, 1..40_usize], 1..60),
        ) {
            let (places, height) = pack(&sizes, 50).unwrap();
            for i in 0..sizes.len() {
                prop_assert!(places[i][0] + sizes[i][0] <= 50);
                prop_assert!(places[i][1] + sizes[i][1] <= height);
                for j in 0..i {
                    let apart = (0..2).any(|k| {
                        places[i][k] + sizes[i][k] <= places[j][k]
                            || places[j][k] + sizes[j][k] <= places[i][k]
                    });
                    prop_assert!(apart, "{i} and {j} overlap");
                }
            }
        }
    }

    #[test]
    fn equal_squares_fill_the_strip() {
        let (_, height) = pack(&[[10, 10]; 20], 50).unwrap();
        assert_eq!(height, 40);
    }

    #[test]
    fn what_is_too_wide_does_not_fit() {
        assert_eq!(pack(&[[51, 1]], 50), None);
        assert_eq!(pack(&[], 50), Some((vec![], 0)));
    }
}
