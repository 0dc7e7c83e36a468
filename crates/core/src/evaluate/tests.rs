//! Cases whose answers are known.

use super::load::LoadedModel;
use super::*;
use crate::mesh::{Mesh, shapes};
use crate::reconstruct::Provenance;
use nalgebra::Vector3;

fn model(mesh: Mesh) -> LoadedModel {
    LoadedModel {
        mesh,
        ..LoadedModel::default()
    }
}

fn parameters() -> Parameters {
    Parameters {
        samples: 20_000,
        floor_mm: -1e6,
        ..Parameters::default()
    }
}

fn near(found: f64, wanted: f64, tolerance: f64) {
    assert!((found - wanted).abs() <= tolerance, "{found}, not {wanted}");
}

#[test]
fn a_model_that_is_the_truth_is_perfect() {
    let truth = shapes::torus(0.04, 0.015, 96, 48);
    let found = evaluate(&model(truth.clone()), &truth, &parameters()).unwrap();
    near(found.whole.accuracy.unwrap().max_mm, 0.0, 1e-6);
    near(found.whole.completeness.unwrap().max_mm, 0.0, 1e-6);
    assert!(found.whole.f_scores.iter().all(|f| f.f_score == 1.0));
    near(found.whole.normals.unwrap().mean_degrees, 0.0, 0.1);
    assert!(found.model.watertight && found.model == found.truth);
    assert_eq!((found.model.genus, found.model.components), (Some(1), 1));
    // The inside of the ring is deep within the hull; the model has it.
    near(found.whole.concave.unwrap().distances.mean_mm, 0.0, 2e-3);
    assert!(found.whole.expected.is_none() && found.by_provenance.is_empty());
}

#[test]
fn a_ball_that_has_grown_by_a_millimetre_has_that_bias() {
    let truth = shapes::sphere(0.03, 6);
    let found = evaluate(&model(shapes::sphere(0.031, 6)), &truth, &parameters()).unwrap();
    near(found.whole.bias.unwrap().mean_mm, 1.0, 0.01);
    near(found.whole.accuracy.unwrap().median_mm, 1.0, 0.01);
    near(found.whole.completeness.unwrap().mean_mm, 1.0, 0.01);
    assert_eq!(found.whole.f_score_at(0.5), Some(0.0));
    assert_eq!(found.whole.f_score_at(2.0), Some(1.0));
    near(
        found.volume_error_percent,
        100.0 * ((31.0_f64 / 30.0).powi(3) - 1.0),
        1e-3,
    );
    assert!(
        found.whole.concave.is_none() && found.whole.rims.is_none() && found.whole.walls.is_none()
    );
    let shrunk = evaluate(&model(shapes::sphere(0.029, 6)), &truth, &parameters()).unwrap();
    near(shrunk.whole.bias.unwrap().mean_mm, -1.0, 0.01);
}

/// A plate of 100 mm x 100 mm x 4 mm.
fn plate(shift: f32) -> Mesh {
    let mut mesh = shapes::cube(0.05);
    mesh.vertices.iter_mut().for_each(|v| {
        v.z = v.z * 0.04 + shift;
    });
    mesh
}

#[test]
fn a_plate_that_has_moved_is_off_by_as_much_and_as_thick_as_before() {
    let found = evaluate(&model(plate(0.0015)), &plate(0.0), &parameters()).unwrap();
    // One face is 1.5 mm outside, the other as much inside, less near its border, where the sides are nearer;
    // of the sides 1.5 mm of height is outside.
    near(found.whole.bias.unwrap().mean_mm, 0.04, 0.01);
    near(found.whole.accuracy.unwrap().median_mm, 1.5, 1e-3);
    near(found.whole.accuracy.unwrap().max_mm, 1.5, 1e-3);
    let walls = found.whole.walls.unwrap();
    near(walls.truth_mean_mm, 4.0, 1e-3);
    near(walls.error.unwrap().max_mm, 0.0, 5e-3);
    assert_eq!(walls.lost_share, 0.0);
    // All of the border is near a rim, 3 mm wide on either side of each edge.
    let rims = found.whole.rims.unwrap();
    let share = rims.completeness.unwrap().samples as f64 / 20_000.0;
    let rim_area = 2.0 * (100.0 * 100.0 - 94.0 * 94.0) + 4.0 * 100.0 * 4.0;
    near(share, rim_area / (2.0 * 1e4 + 4.0 * 400.0), 0.01);
}

#[test]
fn the_floor_is_left_out() {
    let truth = plate(0.002);
    let found = evaluate(
        &model(plate(0.003)),
        &truth,
        &Parameters {
            samples: 20_000,
            ..Parameters::default()
        },
    );
    // The undersides, at 0 and at 1 mm, do not count; the tops differ by 1 mm.
    near(found.unwrap().whole.completeness.unwrap().max_mm, 1.0, 1e-3);
    let high = Parameters {
        floor_mm: 100.0,
        ..parameters()
    };
    let error = evaluate(&model(plate(0.0)), &truth, &high).unwrap_err();
    assert!(error.to_string().contains("model") && error.to_string().contains("100 mm"));
}

/// A box of 60 mm with a pit of 40 mm x 40 mm x `depth` in its top.
fn box_with_pit(depth: f32) -> Mesh {
    let mut mesh = Mesh::default();
    for (half, z) in [
        (0.03, 0.0),
        (0.03, 0.06),
        (0.02, 0.06),
        (0.02, 0.06 - depth),
    ] {
        for (x, y) in [(-half, -half), (half, -half), (half, half), (-half, half)] {
            mesh.vertices.push([x, y, z].into());
        }
    }
    for ring in 0..3_u32 {
        for i in 0..4 {
            let (a, b) = (4 * ring + i, 4 * ring + (i + 1) % 4);
            mesh.triangles.extend([[a, b, b + 4], [a, b + 4, a + 4]]);
        }
    }
    mesh.triangles
        .extend([[0, 2, 1], [0, 3, 2], [12, 13, 14], [12, 14, 15]]);
    mesh
}

#[test]
fn a_vertex_of_no_triangle_does_not_change_the_concave_part() {
    let truth = box_with_pit(0.04);
    let mut stray = truth.clone();
    stray.vertices.push([0.0, 0.0, 1.0].into());
    let concave = |truth: &Mesh| {
        let found = evaluate(&model(box_with_pit(0.037)), truth, &parameters());
        found.unwrap().whole.concave
    };
    assert_eq!(concave(&stray), concave(&truth));
}

#[test]
fn a_pit_that_is_too_shallow_shows_in_the_concave_part() {
    let truth = box_with_pit(0.04);
    assert!(crate::mesh::check(&truth).is_watertight());
    let found = evaluate(&model(box_with_pit(0.037)), &truth, &parameters()).unwrap();
    let concave = found.whole.concave.unwrap();
    // The floor is off by 3 mm; on the walls' lowest 3 mm the normal meets nothing of its kind before the
    // far wall of the box, or nothing.
    near(concave.distances.p90_mm, 3.0, 1e-3);
    near(concave.distances.max_mm, 30.0, 1e-3);
    let floor = 40.0 * 40.0;
    let walls = 4.0 * 40.0 * 36.0;
    let whole = 6.0 * 60.0 * 60.0 + 4.0 * 40.0 * 40.0;
    near(concave.share, (floor + walls) / whole, 0.005);
    near(
        found.volume_error_percent,
        100.0 * 4.8 / (216.0 - 64.0),
        1e-3,
    );
    let hull = evaluate(&model(box_with_pit(0.0)), &truth, &parameters()).unwrap();
    assert!(hull.whole.concave.unwrap().distances.mean_mm > 20.0);
}

#[test]
fn each_provenance_has_its_own_figures_and_expected_errors_are_held_against_the_truth() {
    let truth = shapes::sphere(0.03, 5);
    let mut mesh = truth.clone();
    let mut provenance = Vec::new();
    let mut expected = Vec::new();
    for v in &mut mesh.vertices {
        // The upper half is 1 mm too large and says so; the lower half is right and fears 0.3 mm.
        let upper = v.z > 0.0;
        if upper {
            let outward: Vector3<f32> = v.coords.normalize();
            *v += outward * 0.001;
        }
        provenance.push(if upper {
            Provenance::Restored
        } else {
            Provenance::Hull
        });
        expected.push(if upper { 0.001 } else { 0.0003 });
    }
    let model = LoadedModel {
        mesh,
        provenance: Some(provenance),
        expected_error: Some(expected),
        ..LoadedModel::default()
    };
    let found = evaluate(&model, &truth, &parameters()).unwrap();
    let [hull, restored] = found.by_provenance.as_slice() else {
        panic!("two provenances: {:?}", found.by_provenance)
    };
    assert_eq!(hull.provenance, Provenance::Hull);
    near(hull.share + restored.share, 1.0, 1e-9);
    near(hull.share, 0.5, 0.05);
    near(hull.figures.bias.unwrap().median_mm, 0.0, 1e-3);
    near(restored.figures.bias.unwrap().median_mm, 1.0, 0.01);
    assert!(hull.figures.f_score_at(0.5) > Some(0.95));
    assert!(restored.figures.f_score_at(0.5) < Some(0.1));
    let said = restored.figures.expected.unwrap();
    near(said.expected_mean_mm, 1.0, 0.05);
    near(said.actual_mean_mm, 1.0, 0.05);
    assert!(said.within_twice_share > 0.99);
    let lowest = found.by_expected_error.first().unwrap();
    assert_eq!((lowest.from_mm, lowest.to_mm), (0.25, Some(0.5)));
    near(lowest.expected.actual_median_mm, 0.0, 1e-3);
    let counted: usize = found
        .by_expected_error
        .iter()
        .map(|b| b.expected.samples)
        .sum();
    assert_eq!(counted, 20_000);
}

#[test]
fn the_same_question_has_the_same_answer_whatever_the_number_of_threads() {
    let (truth, model) = (box_with_pit(0.04), model(box_with_pit(0.03)));
    let answer = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let found = pool.install(|| evaluate(&model, &truth, &parameters()).unwrap());
        serde_json::to_string(&found).unwrap()
    };
    assert_eq!(answer(1), answer(3));
}

#[test]
fn edges_and_dents_are_told_from_the_rest() {
    let truth = shapes::cube(0.03);
    let of = |half: f32| {
        let found = evaluate(&model(shapes::cube(half)), &truth, &parameters()).unwrap();
        let edges = found.whole.edges.unwrap();
        (
            edges.share,
            edges.distances.mean_mm,
            found.whole.dented_share,
        )
    };
    let (share, mean, dented) = of(0.03);
    // A strip of a bit more than a millimetre on either side of each edge.
    assert!((0.05..0.11).contains(&share), "{share}");
    near(mean, 0.0, 1e-6);
    assert_eq!(dented, 0.0);
    // Half a millimetre too small or too large on each side.
    let (_, mean, dented) = of(0.0295);
    assert!((0.499..0.6).contains(&mean), "{mean}");
    assert_eq!(dented, 1.0);
    assert_eq!(of(0.0305).2, 0.0);
    let ball = shapes::sphere(0.03, 6);
    let found = evaluate(&model(ball.clone()), &ball, &parameters()).unwrap();
    assert_eq!((found.whole.edges, found.whole.dented_share), (None, 0.0));
}

#[test]
fn edges_are_as_wide_on_a_large_object_as_on_a_small_one_and_whatever_the_number_of_samples() {
    let width_mm = |half: f32, samples: usize| {
        let cube = shapes::cube(half);
        let parameters = Parameters {
            samples,
            ..parameters()
        };
        let found = evaluate(&model(cube.clone()), &cube, &parameters).unwrap();
        // Of each face, a strip along its border.
        let share = found.whole.edges.map_or(0.0, |edges| edges.share);
        1e3 * f64::from(half) * (1.0 - (1.0 - share).sqrt())
    };
    for (half, samples) in [(0.03, 20_000), (0.03, 5_000), (0.2, 50_000)] {
        near(width_mm(half, samples), 1.3, 0.3);
    }
}

#[test]
fn facets_show_in_the_normals_of_the_outside_and_hollows_do_not() {
    let truth = shapes::sphere(0.03, 6);
    let mean = |found: &Evaluation| found.whole.outside_normals.unwrap().mean_degrees;
    let smooth = evaluate(&model(truth.clone()), &truth, &parameters()).unwrap();
    assert!(mean(&smooth) < 1.0, "{}", mean(&smooth));
    // The facets of a ball of 320 triangles are off by some 10 degrees at their corners.
    let cut = evaluate(&model(shapes::sphere(0.03, 2)), &truth, &parameters()).unwrap();
    assert!((2.0..9.0).contains(&mean(&cut)), "{}", mean(&cut));
    // A pit that is not there changes nothing outside.
    let pit = box_with_pit(0.04);
    let filled = evaluate(&model(box_with_pit(0.0)), &pit, &parameters()).unwrap();
    assert!(mean(&filled) < 1.5, "{}", mean(&filled));
}
