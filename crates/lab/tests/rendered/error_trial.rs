//! Tests whether the errors that models state are right: shapes, rigs and seeds, each reconstructed, compared with the
//! truth and pooled by provenance. `make error-trial` runs all of them and prints a table, the tests some small ones.

use nalgebra::Point3;
use rayon::prelude::*;
use scand_core::evaluate::load::LoadedModel;
use scand_core::evaluate::{self, Expected, evaluate};
use scand_core::mesh::Bvh;
use scand_core::reconstruct::{self, NoProgress, Provenance, reconstruct};
use scand_lab::{Options, Shape, Simulation};

/// One reconstruction.
struct Run {
    options: Options,
    resolution: f64,
}

impl Run {
    fn new(shape: Shape, seed: u64, cameras: usize, depth_cameras: usize) -> Self {
        Self {
            options: Options {
                shape,
                seed,
                cameras,
                depth_cameras,
                width: 640,
                height: 480,
                ..Options::default()
            },
            resolution: 80.0,
        }
    }

    fn full(mut self) -> Self {
        (self.options.width, self.options.height) = (1280, 960);
        self.resolution = 200.0;
        self
    }

    /// What the model states and what is.
    fn found(&self) -> Found {
        let simulation = Simulation::new(self.options.clone()).unwrap();
        let mut parameters = reconstruct::Parameters::default();
        parameters.hull.resolution = self.resolution;
        let model = reconstruct(&simulation.scene(0), &parameters, &NoProgress)
            .unwrap()
            .model;
        let truth = Bvh::new(simulation.truth());
        let of_vertex = |p: &Point3<f32>| truth.closest_point(p.cast()).unwrap().distance;
        let actual = model.mesh.vertices.par_iter().map(of_vertex);
        let actual = actual.collect::<Vec<f64>>().into_iter();
        let stated = model.expected_error.iter().map(|&stated| f64::from(stated));
        let pairs = stated.zip(actual).map(|(s, a)| (1e3 * s, 1e3 * a));
        let vertices = model.provenance.iter().copied().zip(pairs).collect();
        let model = LoadedModel {
            mesh: model.mesh,
            provenance: Some(model.provenance),
            expected_error: Some(model.expected_error),
            ..LoadedModel::default()
        };
        let parameters = evaluate::Parameters {
            samples: 20_000,
            ..evaluate::Parameters::default()
        };
        let found = evaluate(&model, simulation.truth(), &parameters).unwrap();
        let parts = found.by_provenance.into_iter();
        let parts = parts.filter_map(|part| Some((part.provenance, part.figures.expected?)));
        Found {
            whole: found.whole.expected.unwrap(),
            parts: parts.collect(),
            vertices,
        }
    }
}

/// What a model states and what is.
struct Found {
    whole: Expected,
    parts: Vec<(Provenance, Expected)>,
    /// The stated and the actual error of each vertex, in millimetres.
    vertices: Vec<(Provenance, (f64, f64))>,
}

/// What was found of one provenance in all runs together, each sample counting the same.
#[derive(Default)]
struct Pool {
    samples: f64,
    stated: f64,
    actual: f64,
    within: f64,
    beyond: f64,
    worst_ratio: f64,
    /// The stated and the actual error of each vertex, in millimetres.
    vertices: Vec<(f64, f64)>,
}

impl Pool {
    fn add(&mut self, expected: &Expected) {
        let samples = expected.samples as f64;
        self.samples += samples;
        self.stated += samples * expected.expected_mean_mm;
        self.actual += samples * expected.actual_mean_mm;
        self.within += samples * expected.within_share;
        self.beyond += samples * expected.beyond_thrice_share;
        // Some dozens of samples have no mean to speak of.
        if samples >= 300.0 {
            self.worst_ratio = self
                .worst_ratio
                .max(expected.actual_over_expected.unwrap_or(0.0));
        }
    }

    fn join(&mut self, other: Self) {
        self.samples += other.samples;
        self.stated += other.stated;
        self.actual += other.actual;
        self.within += other.within;
        self.beyond += other.beyond;
        self.worst_ratio = self.worst_ratio.max(other.worst_ratio);
        self.vertices.extend(other.vertices);
    }

    /// How the ranks of stated and actual errors of all vertices correlate, and how much the actual ones spread: the
    /// largest tenth over the smallest.
    fn rank_and_spread(&self) -> Option<(f64, f64)> {
        let all = Expected::of(&self.vertices)?;
        Some((all.rank_correlation?, all.actual_spread?))
    }

    fn ratio(&self) -> f64 {
        self.actual / self.stated
    }

    fn line(&self) -> String {
        let (rank, spread) = self.rank_and_spread().unwrap_or((f64::NAN, f64::NAN));
        format!(
            "stated {:.2} mm, actual {:.2} mm, ratio {:.2} (worst run {:.2}), within {:.0} %, beyond three times {:.1} %, rank {rank:.2}, spread {spread:.1}",
            self.stated / self.samples,
            self.actual / self.samples,
            self.ratio(),
            self.worst_ratio,
            100.0 * self.within / self.samples,
            100.0 * self.beyond / self.samples
        )
    }
}

fn line_of(expected: &Expected) -> String {
    format!(
        "{} samples, stated {:.3}, actual {:.3}, within {:.2}, beyond {:.3}, rank {:.2}, spread {:.1}",
        expected.samples,
        expected.expected_mean_mm,
        expected.actual_mean_mm,
        expected.within_share,
        expected.beyond_thrice_share,
        expected.rank_correlation.unwrap_or(f64::NAN),
        expected.actual_spread.unwrap_or(f64::NAN)
    )
}

/// Runs all, prints each, and pools them by provenance.
fn pooled(runs: &[Run]) -> Vec<(Provenance, Pool)> {
    let mut pools: Vec<(Provenance, Pool)> = Provenance::ALL
        .map(|provenance| (provenance, Pool::default()))
        .into();
    for run in runs {
        let Options {
            shape,
            seed,
            cameras,
            depth_cameras,
            ..
        } = run.options;
        let name = format!("{shape:?}, seed {seed}, {cameras} + {depth_cameras} cameras");
        let found = run.found();
        println!("shown: {name}, whole: {}", line_of(&found.whole));
        for (provenance, expected) in found.parts {
            println!("shown: {name}, {provenance:?}: {}", line_of(&expected));
            pool_of(&mut pools, provenance).add(&expected);
        }
        for (provenance, pair) in found.vertices {
            pool_of(&mut pools, provenance).vertices.push(pair);
        }
    }
    show(&pools);
    pools
}

fn pool_of(pools: &mut [(Provenance, Pool)], provenance: Provenance) -> &mut Pool {
    let mut pool = pools.iter_mut().filter(|(p, _)| *p == provenance);
    &mut pool.next().unwrap().1
}

fn show(pools: &[(Provenance, Pool)]) {
    for (provenance, pool) in pools.iter().filter(|(_, pool)| pool.samples > 0.0) {
        println!("shown: {provenance:?}: {}", pool.line());
    }
}

/// What is demanded of the hull: that stated errors are neither far too small nor far too large. `most_within` is the
/// largest share of it that may be within what it states.
fn hold_hull(pools: &[(Provenance, Pool)], most_within: f64) {
    let (_, hull) = pools.iter().find(|(p, _)| *p == Provenance::Hull).unwrap();
    let words = hull.line();
    assert!((0.5..=1.5).contains(&hull.ratio()), "{words}");
    assert!(hull.beyond < 0.05 * hull.samples, "{words}");
    assert!(
        (0.5..=most_within).contains(&(hull.within / hull.samples)),
        "{words}"
    );
}

/// What is demanded of the other provenances: that what was restored states about its error, and what was guessed not
/// far too little.
fn hold_others(pools: &[(Provenance, Pool)]) {
    for (provenance, pool) in pools.iter().filter(|(_, pool)| pool.samples >= 300.0) {
        let words = format!("{provenance:?}: {}", pool.line());
        match provenance {
            Provenance::Hull | Provenance::Table => {}
            Provenance::Restored => assert!((0.5..=1.5).contains(&pool.ratio()), "{words}"),
            _ => assert!(pool.ratio() <= 1.5, "{words}"),
        }
        if *provenance != Provenance::Table {
            assert!(pool.worst_ratio <= 2.5, "{words}");
        }
    }
}

/// What is demanded of many runs: places that state more are farther off. The table is stated as a whole. With fewer
/// than three seeds most of what is bridged is the walls of a few cups, whose errors nothing ranks
/// (`design/surface.md`).
fn hold_ranks(pools: &[(Provenance, Pool)]) {
    for (provenance, pool) in pools {
        if let Some((rank, spread)) = pool.rank_and_spread()
            && *provenance != Provenance::Table
            && spread > 5.0
        {
            assert!(rank >= 0.3, "{provenance:?}: {}", pool.line());
        }
    }
}

/// Shapes that constants of stated errors were set on, with other seeds than the trial's.
const TUNED: [Shape; 10] = [
    Shape::Box,
    Shape::Bowl,
    Shape::Cup,
    Shape::Egg,
    Shape::Torus,
    Shape::Relief,
    Shape::Tray,
    Shape::Mug,
    Shape::Ashtray,
    Shape::Vase,
];

/// All shapes with `N` seeds, which no constant was chosen on, and four rigs each. Shapes that had no part in setting
/// constants are pooled by themselves, too.
#[test]
#[ignore = "takes many minutes: make error-trial"]
fn error_trial() {
    let count = std::env::var("N").map_or(3, |n| n.parse().unwrap());
    let rigs = [(11, 1), (11, 0), (6, 1), (16, 1)];
    let runs = Shape::ALL.into_iter().flat_map(|shape| {
        (21..21 + count).flat_map(move |seed| {
            rigs.map(|(cameras, depths)| Run::new(shape, seed, cameras, depths).full())
        })
    });
    let (tuned, others): (Vec<Run>, Vec<Run>) =
        runs.partition(|run| TUNED.contains(&run.options.shape));
    println!("shown: shapes that constants were set on");
    let mut pools = pooled(&tuned);
    println!("shown: other shapes");
    for ((_, pool), (_, other)) in pools.iter_mut().zip(pooled(&others)) {
        pool.join(other);
    }
    println!("shown: all");
    show(&pools);
    hold_hull(&pools, 0.85);
    hold_others(&pools);
    hold_ranks(&pools);
}

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use super::*;

    #[test]
    fn what_the_hull_states_is_true_of_a_dozen_small_runs() {
        let shapes = [
            Shape::Egg,
            Shape::Box,
            Shape::Ball,
            Shape::Prism,
            Shape::Torus,
            Shape::Relief,
        ];
        let of_shape =
            |(shape, seed)| [(7, seed), (11, seed + 1)].map(|(n, s)| Run::new(shape, s, n, 1));
        let runs: Vec<Run> = shapes.into_iter().zip(4..).flat_map(of_shape).collect();
        // Most of these shapes are smooth, and many cameras see them: they state twice their error. The constants were
        // chosen on all shapes and rigs, where few views state too little.
        hold_hull(&pooled(&runs), 0.88);
    }

    #[test]
    fn a_lid_that_nothing_looked_into_states_what_it_may_hide() {
        let open = [Shape::Bowl, Shape::Cup, Shape::Ashtray].map(|s| Run::new(s, 4, 11, 0));
        for (provenance, pool) in pooled(&open) {
            if provenance == Provenance::Hull {
                let words = pool.line();
                assert!((0.4..=2.5).contains(&pool.ratio()), "{words}");
                assert!(pool.worst_ratio <= 2.5, "{words}");
            }
        }
    }

    #[test]
    fn what_depth_restored_or_left_as_a_guess_states_its_error() {
        let shapes = [Shape::Bowl, Shape::Cup, Shape::Vase, Shape::TwoPits];
        hold_others(&pooled(&shapes.map(|shape| Run::new(shape, 5, 11, 1))));
    }
}
