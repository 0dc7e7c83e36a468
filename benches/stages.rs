//! Times each stage of a replay by itself, and the whole replay from a file to files on disk, on the first capture
//! of a recording: `recordings/bowl_with_fruit.mcap`, or the one that `SCAND_BENCH_RECORDING` names. The file is in
//! the page cache; all threads work.

use clap::Parser;
use divan::Bencher;
use scand::capture::{CaptureFacts, CaptureSession};
use scand::commands::{self, Cli};
use scand::config::Config;
use scand::description::Description;
use scand::image::Mask;
use scand::mesh::vertex_normals;
use scand::output;
use scand::reconstruct::restore::{self, Restored, Source, Template};
use scand::reconstruct::{
    DepthView, FusedCaptures, NoProgress, Reconstruction, Scene, depth, fairing, hull, reconstruct,
    region, silhouette, texture,
};
use scand::report;
use scand::storage::StagedFolder;
use std::path::PathBuf;
use std::sync::LazyLock;

/// Pixels around the hull's image in which depth is enhanced, as a reconstruction has it.
const OBJECT_MARGIN_PX: usize = 4;

static CONFIG: LazyLock<Config> = LazyLock::new(Config::default);

static LOADED: LazyLock<(Scene, CaptureFacts)> = LazyLock::new(load);

static MADE: LazyLock<Reconstruction> = LazyLock::new(|| {
    let parameters = CONFIG.reconstruction();
    reconstruct(&LOADED.0, &parameters, &NoProgress).expect("a capture that can be reconstructed")
});

fn main() {
    divan::main();
}

fn recording() -> PathBuf {
    let given = std::env::var_os("SCAND_BENCH_RECORDING").map(PathBuf::from);
    let own = || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("recordings/bowl_with_fruit.mcap");
    given.unwrap_or_else(own)
}

fn load() -> (Scene, CaptureFacts) {
    let session = CaptureSession::open(&recording(), &CONFIG.sync).expect("a recording");
    let first = &session.captures()[0].id;
    session.load(first).expect("a sound capture")
}

fn cones() -> Vec<hull::Cone<'static>> {
    let views = LOADED.0.colors.iter().zip(&MADE.silhouettes);
    views
        .map(|(view, silhouette)| hull::Cone::new(&view.camera, &silhouette.level))
        .collect()
}

/// What each depth camera sees of the hull, and the pixels that the object can cover.
fn fronts() -> Vec<(region::HullRenderings, Mask)> {
    let normals = vertex_normals(&MADE.hull);
    let threshold = CONFIG.region.front_threshold;
    let front = |view: &DepthView| {
        let front = region::HullRenderings::render(&MADE.hull, &normals, &view.camera, threshold);
        let object = front.object_pixels(OBJECT_MARGIN_PX);
        (front, object)
    };
    LOADED.0.depths.iter().map(front).collect()
}

/// From the file to decoded pictures.
#[divan::bench]
fn a_reading(bencher: Bencher) {
    bencher.bench_local(load);
}

/// All cameras' silhouettes.
#[divan::bench]
fn b_silhouettes(bencher: Bencher) {
    use rayon::prelude::*;
    let scene = &LOADED.0;
    bencher.bench_local(|| {
        let views = scene.colors.par_iter();
        views
            .map(|view| silhouette::extract(view, &scene.volume, &CONFIG.silhouette))
            .collect::<Vec<_>>()
    });
}

/// The visual hull from the silhouettes.
#[divan::bench]
fn c_hull(bencher: Bencher) {
    let parameters = &CONFIG.hull;
    LazyLock::force(&MADE);
    bencher.bench_local(|| {
        let hull = hull::Hull::new(cones(), LOADED.0.volume, parameters.least_views);
        let lattice = hull::lattice(&hull, parameters).expect("a hull");
        hull::extract(&hull, &lattice, parameters).map(|extracted| extracted.surface)
    });
}

/// The fairing of the hull, with its surface.
#[divan::bench]
fn c_hull_faired(bencher: Bencher) {
    let parameters = &CONFIG.hull;
    LazyLock::force(&MADE);
    let hull = hull::Hull::new(cones(), LOADED.0.volume, parameters.least_views);
    let lattice = hull::lattice(&hull, parameters).expect("a hull");
    bencher.bench_local(|| {
        let faired = fairing::fair_hull(&hull, &lattice, &MADE.hull, parameters).ok()?;
        hull::extract_solid(&faired.solid, &lattice, parameters).map(|found| found.surface)
    });
}

/// The enhancement of all depth cameras' bursts.
#[divan::bench]
fn d_depth(bencher: Bencher) {
    LazyLock::force(&MADE);
    bencher.bench_local(|| {
        let views = LOADED.0.depths.iter().zip(fronts());
        views
            .map(|(view, (_, object))| depth::enhance(view, &object, &CONFIG.depth))
            .collect::<Vec<_>>()
    });
}

/// The search for concave regions.
#[divan::bench]
fn e_region(bencher: Bencher) {
    let (scene, made) = (&LOADED.0, &*MADE);
    bencher.with_inputs(fronts).bench_local_values(|fronts| {
        let views = scene.depths.iter().zip(&made.depths).zip(fronts);
        views
            .map(|((view, found), (front, object))| {
                let (enhanced, volume) = (&found.enhanced, &scene.volume);
                let bias = region::bias(
                    || front.clone(),
                    view,
                    enhanced,
                    volume,
                    &object,
                    &CONFIG.region,
                );
                region::find(front, enhanced, bias, &object, &CONFIG.region)
            })
            .collect::<Vec<_>>()
    });
}

/// The restoration of the concave regions, from the hull to the model without its texture.
#[divan::bench]
fn f_restoration(bencher: Bencher) {
    let parameters = &CONFIG.hull;
    LazyLock::force(&MADE);
    let hull = hull::Hull::new(cones(), LOADED.0.volume, parameters.least_views);
    let lattice = hull::lattice(&hull, parameters).expect("a hull");
    let extracted = hull::extract(&hull, &lattice, parameters).expect("a hull");
    let template = Template {
        hull: &hull,
        fused_captures: &FusedCaptures::default(),
        solid: &hull,
        faired: None,
        extracted: &extracted,
        lattice: &lattice,
        parameters,
        front_threshold: CONFIG.region.front_threshold,
    };
    bencher.bench_local(|| restored(&template));
}

fn restored(template: &Template) -> Restored {
    let views = LOADED.0.depths.iter().zip(&MADE.depths);
    let sources: Vec<Source> = views
        .enumerate()
        .map(|(number, (view, found))| Source {
            number,
            camera: &view.camera,
            depth: &found.enhanced,
            regions: &found.regions,
        })
        .collect();
    restore::restore(template, &sources, &CONFIG.restoration).expect("a system that can be solved")
}

/// The model's texture.
#[divan::bench]
fn g_texture(bencher: Bencher) {
    let made = &*MADE;
    let masks: Vec<&Mask> = made.silhouettes.iter().map(|s| &s.level).collect();
    bencher.bench_local(|| texture::paint(&made.model, &LOADED.0, &masks, &CONFIG.texture));
}

/// What a model says of its capture.
fn described(facts: &CaptureFacts) -> Description {
    Description {
        capture: facts.id.to_string(),
        ..Description::default()
    }
}

/// Measuring, judging and the preview's pixels.
#[divan::bench]
fn h_report(bencher: Bencher) {
    let (scene, facts) = &*LOADED;
    LazyLock::force(&MADE);
    bencher.bench_local(|| {
        let measured = report::measure(scene, &MADE, CONFIG.method);
        let verdict = report::judge(&measured, facts, &CONFIG.verdict);
        report::preview(scene, &MADE, &verdict, &described(facts))
    });
}

/// Encoding the models and the preview, and writing them.
#[divan::bench]
fn i_files(bencher: Bencher) {
    let (scene, facts) = &*LOADED;
    let measured = report::measure(scene, &MADE, CONFIG.method);
    let verdict = report::judge(&measured, facts, &CONFIG.verdict);
    let (id, about) = (facts.id.as_str(), described(facts));
    let sheet = report::preview(scene, &MADE, &verdict, &about);
    let folder = tempfile::tempdir().expect("a folder");
    bencher.bench_local(|| {
        let preview = || output::encode_png(&sheet).expect("a picture");
        let glb = || output::glb::encode(&MADE.model, &about, &CONFIG.glb).expect("a model");
        let ply = || output::ply::encode(&MADE.model, &about).expect("a model");
        let (preview, (glb, ply)) = rayon::join(preview, || rayon::join(glb, ply));
        let staged = StagedFolder::create(&folder.path().join(id)).expect("a folder");
        for (name, bytes) in [
            ("model.glb", glb),
            ("model.ply", ply),
            ("preview.png", preview),
        ] {
            staged.write(name, &bytes).expect("a file");
        }
        staged.commit(true).expect("a folder");
    });
}

/// All of it, as the command does it.
#[divan::bench]
fn whole_replay(bencher: Bencher) {
    let folder = tempfile::tempdir().expect("a folder");
    let (first, recording) = (LOADED.1.id.as_str(), recording());
    bencher.bench_local(|| {
        let recording = recording.as_os_str();
        let out = folder.path().as_os_str();
        let words = ["scand", "--quiet", "--force", "--capture", first];
        let files = ["--replay".as_ref(), recording, "--out".as_ref(), out];
        let all = words.into_iter().map(AsRef::as_ref).chain(files);
        commands::run(Cli::parse_from(all)).expect("a replay")
    });
}
