//! Times the silhouettes of a bowl with fruit in simulated pictures of 2560x1920 pixels, each compared with its
//! background: of one camera alone, and of four on all threads, as in a reconstruction.

use divan::Bencher;
use rayon::prelude::*;
use scand::reconstruct::Scene;
use scand::reconstruct::silhouette::{Parameters, extract};
use scand_lab::{Options, Shape, Simulation};
use std::sync::LazyLock;

static SCENE: LazyLock<Scene> = LazyLock::new(|| {
    let options = Options {
        shape: Shape::FruitBowl,
        cameras: 4,
        depth_cameras: 0,
        width: 2560,
        height: 1920,
        ..Options::default()
    };
    Simulation::new(options).expect("good options").scene(0)
});

fn main() {
    divan::main();
}

/// The first camera, one thread.
#[divan::bench]
fn one_camera(bencher: Bencher) {
    let (scene, parameters) = (&*SCENE, Parameters::default());
    bencher.bench_local(|| extract(&scene.colors[0], &scene.volume, &parameters));
}

/// Four cameras, all threads.
#[divan::bench]
fn four_cameras(bencher: Bencher) {
    let (scene, parameters) = (&*SCENE, Parameters::default());
    bencher.bench_local(|| {
        let views = scene.colors.par_iter();
        views
            .map(|view| extract(view, &scene.volume, &parameters))
            .collect::<Vec<_>>()
    });
}
