//! Closed surfaces keep every ray in.

mod common;

use common::closed::{AIMS, surfaces};
use common::{Blobs, Random, anything, spelt};
use enf_geometry::Instructions;

#[test]
fn the_surfaces_are_closed() {
    for surface in surfaces() {
        surface.assert_closed();
    }
}

/// A million rays, at vertices, edges and along axes and diagonals too; ten times as many hits.
#[test]
fn no_ray_leaves_a_closed_surface() {
    const RAYS: usize = 100_000;
    let mut random = Random(0x1EAC);
    let mut rays = 0;
    for surface in surfaces() {
        let blobs = Blobs::new(&surface.triangles, surface.delta);
        let tile = blobs.tile();
        for _ in 0..RAYS / 1000 {
            let queries: Vec<_> = (0..1000).map(|_| anything(surface.ray(&mut random))).collect();
            for (i, (query, hit)) in queries.iter().zip(tile.batch(&queries)).enumerate() {
                let lost = |way| format!("{}, {way}: lost {}", surface.name, spelt(query));
                assert!(hit.is_some(), "{}", lost("batch"));
                let (way, hit) = match i % 4 {
                    0 => ("grid", tile.grid.nearest(query)),
                    1 => ("portable", tile.bvh.nearest_with(Instructions::Portable, query)),
                    _ => ("hierarchy", tile.bvh.nearest(query)),
                };
                assert!(hit.is_some(), "{}", lost(way));
                rays += 1;
            }
        }
    }
    assert_eq!(rays, RAYS * surfaces().len());
}

/// What makes that a test: a surface that lacks one triangle loses rays, as do edges if they belong to nobody.
#[test]
fn a_missing_triangle_is_noticed() {
    let mut random = Random(0x1EAD);
    for mut surface in surfaces() {
        let gone = random.below(surface.triangles.len());
        let [a, b, c] = surface.triangles.swap_remove(gone);
        let blobs = Blobs::new(&surface.triangles, surface.delta);
        let tile = blobs.tile();
        let middle = a / 3.0 + b / 3.0 + c / 3.0;
        let direction = ((middle - surface.centre) / surface.half.max_element()).normalize();
        let ray = enf_geometry::Ray { origin: surface.centre, direction };
        assert!(tile.bvh.nearest(&anything(ray)).is_none(), "{}", surface.name);
    }
}

/// Rays are aimed in all ways, and those through lattice points do meet several triangles at once.
#[test]
fn aims_are_what_they_say() {
    let mut random = Random(0x1EAE);
    let surfaces = surfaces();
    let lattice = surfaces.iter().find(|s| s.name == "box on a lattice").unwrap();
    let blobs = Blobs::new(&lattice.triangles, lattice.delta);
    let tile = blobs.tile();
    let (mut shared, mut rays) = (0, 0);
    for _ in 0..200 * AIMS {
        let query = anything(lattice.ray(&mut random));
        assert!((query.ray.direction.length() - 1.0).abs() < 1e-6);
        let first = tile.by_force(&query).unwrap();
        let next = tile.by_force(&enf_geometry::Query { exclude: first.global, ..query });
        shared += usize::from(next.is_some_and(|next| next.t == first.t));
        rays += 1;
    }
    assert!(shared > rays / 4, "{shared} of {rays}");
}
