//! Light that can be computed by hand, through the real binaries.
//!
//! Seeds are fixed, so no test is flaky; the bound of each statistical test is at least 4 standard deviations of
//! its estimate, so that a change of the random numbers would fail it with a probability below 1e-4.

mod common;

use common::{Model, bin, furnace, number, ok, photons, traced, watts};
use enf_layout::photon::{PHOTON_DIRECT, PhotonRecord};
use std::f64::consts::PI;
use std::path::Path;

/// Partition, grid and trace.
fn trace(
    scene: &Path,
    store: &Path,
    photons_per_light: &str,
    partition: &[&str],
) -> serde_json::Value {
    traced(scene, store, partition, &["--photons-per-light", photons_per_light])
}

fn luminance(rgb: [f32; 3]) -> f64 {
    0.2126 * f64::from(rgb[0]) + 0.7152 * f64::from(rgb[1]) + 0.0722 * f64::from(rgb[2])
}

fn flux(photons: &[PhotonRecord], mut keep: impl FnMut(&PhotonRecord) -> bool) -> f64 {
    photons.iter().filter(|p| keep(p)).map(watts).sum()
}

/// A closed box that glows and reflects everywhere alike: L = Le / (1 - rho), in one room or in many.
#[test]
fn a_furnace_keeps_its_radiance() {
    let dir = tempfile::tempdir().unwrap();
    let scene = dir.path().join("furnace.obj");
    let mut model = Model::default();
    model.object("box");
    model.material("glow");
    model.cuboid([0.0; 3], [4.0, 3.0, 2.5], true);
    model.write(&scene, "newmtl glow\nKd 0.5 0.5 0.5\nKe 1 1 1\n");
    let area = 2.0 * (4.0 * 3.0 + 4.0 * 2.5 + 3.0 * 2.5);
    for rooms in ["1", "8"] {
        let store = dir.path().join(format!("furnace-{rooms}.enf"));
        let stats = trace(&scene, &store, "200k", &["--rooms", rooms]);
        assert_eq!(number(&stats, "photons_emitted"), 200_000.0);
        assert_eq!(
            number(&stats, "photons_emitted"),
            number(&stats, "photons_absorbed") + number(&stats, "photons_escaped")
        );
        assert_eq!(number(&stats, "photons_escaped"), 0.0, "the box is closed");
        // Irradiance is pi L. One photon's impacts are geometric: deviation sqrt(rho)/(1-rho) of a mean 1/(1-rho).
        let expected = PI * 1.0 / (1.0 - 0.5);
        let found = flux(&photons(&store), |_| true) / area;
        let sigma = expected * (0.5f64.sqrt()) / 200_000f64.sqrt();
        assert!((found - expected).abs() < 4.0 * sigma, "{rooms} rooms: {found} for {expected}");
        assert!((number(&stats, "reflections_mean") - 2.0).abs() < 4.0 * 2f64.sqrt() / 447.0);
    }
}

/// CIE 171:2006, 5.8: an isotropic source of 10 klm in a cube of 4 m; the mean indirect illuminance is
/// (10000 / 96) rho / (1 - rho).
#[test]
fn integrating_cube() {
    let dir = tempfile::tempdir().unwrap();
    for rho in [0.3f64, 0.8] {
        let mesh = dir.path().join("cube.obj");
        let mut model = Model::default();
        model.object("cube");
        model.material("wall");
        model.cuboid([0.0; 3], [4.0; 3], true);
        model.write(&mesh, &format!("newmtl wall\nKd {rho} {rho} {rho}\n"));
        let scene = dir.path().join("cube.toml");
        std::fs::write(
            &scene,
            "[[mesh]]\nfile = \"cube.obj\"\n[[light]]\nname = \"bulb\"\nkind = \"point\"\n\
             position = [2.0, 2.0, 2.0]\nlumens = 10000\n",
        )
        .unwrap();
        let store = dir.path().join(format!("cube-{rho}.enf"));
        let stats = trace(&scene, &store, "200k", &[]);
        assert!((number(&stats, "flux_emitted_w") * 179.0 - 10_000.0).abs() < 1.0);
        let indirect = 179.0 * flux(&photons(&store), |p| p.flags & PHOTON_DIRECT == 0) / 96.0;
        let expected = 10_000.0 / 96.0 * rho / (1.0 - rho);
        // Impacts after the first: mean rho/(1-rho), variance rho/(1-rho)^2.
        let sigma = 10_000.0 / 96.0 * rho.sqrt() / (1.0 - rho) / 200_000f64.sqrt();
        assert!(
            (indirect - expected).abs() < 4.0 * sigma,
            "rho {rho}: {indirect} lx for {expected}, sigma {sigma}"
        );
    }
}

/// CIE 171:2006, 5.2: a Lambertian point source of 1000 cd 3 m above a black floor; E = I0 h^2 / d^4.
#[test]
fn inverse_square() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = dir.path().join("room.obj");
    let mut model = Model::default();
    model.object("room");
    model.material("black");
    model.cuboid([-2.0, -2.0, 0.0], [2.0, 2.0, 3.2], true);
    model.write(&mesh, "newmtl black\nKd 0 0 0\n");
    let scene = dir.path().join("room.toml");
    std::fs::write(
        &scene,
        "[[mesh]]\nfile = \"room.obj\"\n[[light]]\nname = \"spot\"\nkind = \"lambert-point\"\n\
         position = [0.0, 0.0, 3.0]\ndirection = [0.0, 0.0, -1.0]\ncandela = 1000\n",
    )
    .unwrap();
    let store = dir.path().join("room.enf");
    trace(&scene, &store, "1000k", &[]);
    let all = photons(&store);
    // Rings on the floor: flux through a ring of a Lambertian source is pi I0 (sin^2 b - sin^2 a).
    for (inner, outer) in [(0.0, 0.25), (0.25, 0.5), (0.75, 1.0), (1.4, 1.6)] {
        let sin2 = |r: f64| r * r / (r * r + 9.0);
        let expected = PI * 1000.0 * (sin2(outer) - sin2(inner));
        let found = 179.0
            * flux(&all, |p| {
                let [x, y, z] = p.position().map(f64::from);
                let r = x.hypot(y);
                z.abs() < 1e-3 && r >= inner && r < outer
            });
        let n = 1_000_000.0 * (sin2(outer) - sin2(inner));
        let sigma = expected / n.sqrt();
        assert!(
            (found - expected).abs() < 4.0 * sigma,
            "{inner} to {outer} m: {found} lm for {expected}"
        );
        // And as an illuminance at the middle of the ring, to the ring's own width.
        let r = (0.5 * (inner * inner + outer * outer)).sqrt();
        let d2 = r * r + 9.0;
        let e = found / (PI * (outer * outer - inner * inner));
        let closed = 1000.0 * 9.0 / (d2 * d2);
        assert!((e - closed).abs() / closed < 0.01 + 4.0 / n.sqrt(), "{e} lx for {closed}");
    }
}

/// The ledger balances in counts exactly and in flux to rounding, with doors, a mirror, a pane and openings.
#[test]
fn flux_ledger() {
    let dir = tempfile::tempdir().unwrap();
    let scene = dir.path().join("rooms.obj");
    common::two_rooms(&scene);
    let store = dir.path().join("rooms.enf");
    let stats = trace(&scene, &store, "40k", &[]);
    let n = |key: &str| number(&stats, key);
    assert_eq!(n("photons_emitted"), 80_000.0);
    assert_eq!(n("photons_emitted"), n("photons_absorbed") + n("photons_escaped"));
    let balance = n("flux_emitted_w") - n("flux_absorbed_w") - n("flux_escaped_w");
    assert!(balance.abs() < 1e-5 * n("flux_emitted_w"), "{balance} W are missing");
    assert!(n("photons_through_portals") > 500.0, "light goes through the door");
    // Ke (20, 18, 15) on 0.36 m2: pi A L each.
    let each = PI * 0.36 * luminance([20.0, 18.0, 15.0]);
    assert!((n("flux_emitted_w") - 2.0 * each).abs() < 1e-4 * each);
}

/// A picture of the furnace: radiance is the same everywhere, seen through direct and indirect light together.
#[test]
fn furnace_as_a_picture() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnace(dir.path(), 0.4);
    let out = dir.path().join("out");
    ok(bin("enfilade").arg("run").arg(&scene).arg("-o").arg(&out).args([
        "--quiet",
        "--photons-per-light",
        "400k",
        "--view",
        "in",
        "--samples",
        "16",
        "--width",
        "48",
        "--height",
        "48",
    ]));
    let picture = enf_image::read_exr(&out.join("in.exr")).unwrap();
    let green = picture.channel("G").unwrap();
    let mean = green.iter().map(|&g| f64::from(g)).sum::<f64>() / green.len() as f64;
    let expected = 2.0 / (1.0 - 0.4);
    assert!((mean - expected).abs() < 0.01 * expected, "{mean} for {expected}");
}
