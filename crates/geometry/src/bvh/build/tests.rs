//! What is promised about hierarchies, on meshes that nobody would model.

use enf_layout::bvh::{CHILD_INNER, CHILD_NONE, NO_TRIANGLE};
use proptest::prelude::*;

use super::super::BvhView;
use super::*;

type Corners = [[f32; 3]; 3];

fn mesh_of(triangles: &[Corners]) -> Vec<u8> {
    // Indices in the scene with gaps.
    TileMesh::build_blob(triangles.iter().enumerate().map(|(i, &t)| (3 * i as u32 + 5, 7, t)))
}

struct Random(u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(0x5851_F42D_4C95_7F2D).wrapping_add(0x1405_7B7E_F767_814F);
        (self.0 ^ (self.0 >> 33)).wrapping_mul(0xFF51_AFD7_ED55_8CCD) >> 24
    }

    fn unit(&mut self) -> f32 {
        (self.bits() >> 8) as f32 / (1u64 << 32) as f32
    }

    fn point(&mut self) -> [f32; 3] {
        [self.unit(), self.unit(), self.unit()]
    }

    fn triangle(&mut self, at: [f32; 3], size: f32) -> Corners {
        std::array::from_fn(|_| {
            let p = self.point();
            std::array::from_fn(|axis| at[axis] + size * (p[axis] - 0.5))
        })
    }
}

const KINDS: usize = 11;

/// Meshes that are hard on heuristics.
fn nasty(kind: usize, n: usize, seed: u64) -> Vec<Corners> {
    let mut random = Random(seed);
    let one = random.triangle([1.0, 2.0, 3.0], 1.0);
    (0..n)
        .map(|i| {
            let x = i as f32;
            match kind {
                // A cloud, coarse or fine.
                0 => {
                    let at = random.point();
                    random.triangle(at, 0.02)
                }
                1 => random.triangle([0.0; 3], 1.0),
                // The same one, over and over; nothing but points, or one point.
                2 => one,
                3 => [random.point(); 3],
                4 => [[1.0; 3]; 3],
                // The next one is always twice as far, or twice as large: one is cut off at a time.
                5 => random.triangle([2f32.powi(i as i32 % 120), 0.0, 0.0], 0.1),
                6 => random.triangle([0.0; 3], 2f32.powi(i as i32 % 120)),
                // As large as numbers are, and as small.
                7 => one.map(|p| {
                    p.map(|c| if (c * 1e4) as i32 % 2 == 0 { f32::MAX } else { -f32::MAX })
                }),
                8 => random.triangle([0.0; 3], 1e-38),
                // On a line, one beside the other.
                9 => [[x, 0.0, 0.0], [x + 1.0, 0.0, 0.0], [x, 0.0, 0.0]],
                // A floor of large triangles under small things, some of them in two.
                _ if i % 5 == 0 => random.triangle([0.0; 3], 10.0),
                _ => {
                    let at = random.point().map(|p| (4.0 * p).floor());
                    random.triangle(at, 0.001)
                }
            }
        })
        .collect()
}

fn completed(mesh: &TileMesh, delta: f32) -> Vec<u8> {
    let mut blob = build_bvh(mesh, delta);
    complete_bvh(&mut blob, mesh).unwrap();
    blob
}

/// The triangles below a node, each inside the boxes of all that is above it.
fn below(view: &BvhView, mesh: &TileMesh, node: usize, delta: f32, depth: usize) -> Vec<u32> {
    assert!(depth <= enf_layout::bvh::DEPTH);
    let node = &view.nodes[node];
    let mut all = Vec::new();
    for (slot, &child) in node.child.iter().enumerate() {
        if child == CHILD_NONE {
            continue;
        }
        let mine = if child & CHILD_INNER != 0 {
            below(view, mesh, node.nodes as usize + usize::from(child & 7), delta, depth + 1)
        } else {
            let block = &view.blocks[node.blocks as usize + usize::from(child & 7)];
            let count = usize::from(child >> 5) + 1;
            assert!(block.global[count..].iter().all(|&global| global == NO_TRIANGLE));
            block.global[..count].iter().map(|&global| local(mesh, global).unwrap()).collect()
        };
        let grown = 4.0 * f64::from(delta);
        for &triangle in &mine {
            for (axis, bounds) in node.bounds.iter().enumerate() {
                let at = |q: u8| {
                    f64::from(node.origin[axis]) + f64::from(q) * f64::from(node.step[axis])
                };
                for p in mesh.corner_arrays(triangle) {
                    // The largest numbers have no neighbours to round to, and f64 has 53 digits.
                    let fuzz = 1e-15 * (at(255) - at(0));
                    let low = (f64::from(p[axis]) - grown).max(f64::from(f32::MIN)) + fuzz;
                    let high = f64::from(p[axis]) + grown - fuzz;
                    let (lower, upper) = (at(bounds[slot]), at(bounds[slot + WIDTH]));
                    assert!(
                        lower <= low && high <= upper,
                        "{lower} {low} {high} {upper}, {node:?}"
                    );
                }
            }
        }
        all.extend(mine);
    }
    all
}

fn check(triangles: &[Corners], delta: f32) {
    let n = triangles.len();
    let mesh_blob = mesh_of(triangles);
    let mesh = TileMesh::from_blob(&mesh_blob).unwrap();

    let tree = binary::divide(&mesh);
    let blocks = tree.nodes.iter().filter(|node| node.count > 0).count();
    assert!(blocks_needed(n) <= blocks && blocks <= blocks_most(n));
    assert!(tree.nodes.capacity() <= 2 * blocks_most(n) && tree.order.capacity() <= n);
    for widened in [wide::collapse(&tree), wide::collapse_by(&tree, &[], blocks)] {
        assert_eq!(widened.1.len(), blocks);
        assert!(widened.0.len() <= nodes_most(blocks), "{} of {blocks}", widened.0.len());
        assert!(widened.0.capacity() <= nodes_most(blocks) && widened.1.capacity() <= blocks);
    }

    let blob = completed(&mesh, delta);
    assert_eq!(blob, completed(&mesh, delta));
    assert!(blob.len() as u64 <= bvh_bytes_estimate(n as u64));
    let view = BvhView::from_blob(&blob, &mesh, delta).unwrap();
    let mut listed = below(&view, &mesh, 0, delta, 1);
    listed.sort_unstable();
    assert!(listed.iter().copied().eq(0..n as u32));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]
    #[test]
    fn promises_hold_on_nasty_meshes(
        kind in 0..KINDS,
        n in prop_oneof![0usize..80, 0usize..2000],
        seed in any::<u64>(),
        delta in prop_oneof![Just(0.0f32), Just(6e-5), Just(1.0)],
    ) {
        check(&nasty(kind, n, seed), delta);
    }
}

#[test]
fn promises_hold_on_larger_meshes() {
    for kind in 0..KINDS {
        check(&nasty(kind, 20_000, 1), 1e-4);
    }
}

#[test]
fn promises_are_not_generous() {
    // 44 bytes of a triangle are its corners, index and material; and never more than what the largest mesh needs.
    assert!(bvh_bytes_estimate(1 << 20) < 66 << 20);
    assert!(bvh_build_bytes(1 << 20) < 74 << 20);
    for n in 0..5000 {
        assert!(bvh_bytes_estimate(n) <= bvh_bytes_estimate(n + 1));
        assert!(bvh_bytes_estimate(n) <= bvh_build_bytes(n));
    }
}

#[test]
fn groups_of_four_become_blocks() {
    // Scattered so that neighbours in the list are none in space.
    let groups = 100;
    let mut random = Random(3);
    let triangles: Vec<Corners> = (0..4 * groups)
        .map(|i| {
            let group = (7 * i) % groups;
            random.triangle([(group % 10) as f32, (group / 10) as f32, 0.0], 0.01)
        })
        .collect();
    let mesh_blob = mesh_of(&triangles);
    let mesh = TileMesh::from_blob(&mesh_blob).unwrap();
    let blob = completed(&mesh, 1e-5);
    let view = BvhView::from_blob(&blob, &mesh, 1e-5).unwrap();
    assert_eq!(view.block_count(), groups);
    for block in view.blocks {
        let group = |global: u32| 7 * local(&mesh, global).unwrap() % groups as u32;
        assert!(block.global.iter().all(|&global| group(global) == group(block.global[0])));
    }
    assert!(view.node_count() <= 40, "{}", view.node_count());
}

#[test]
fn a_hierarchy_that_is_none_is_named() {
    let mesh_blob = mesh_of(&nasty(0, 50, 2));
    let mesh = TileMesh::from_blob(&mesh_blob).unwrap();
    let blob = build_bvh(&mesh, 1e-4);
    let table = sections::table(&blob).unwrap();
    let nodes = table[SECTION_NODES].offset as usize;
    let child = nodes + std::mem::offset_of!(BvhNode, child);
    let global = table[SECTION_BLOCKS].offset as usize + std::mem::offset_of!(LeafBlock, global);
    let error = |at: usize, value: u8| {
        let mut bad = blob.clone();
        bad[at] = value;
        complete_bvh(&mut bad, &mesh).unwrap_err().0
    };
    assert!(error(global, 100).contains("has triangle 50 of 50"));
    let inner = (0..WIDTH).find(|&s| blob[child + s] == CHILD_INNER).unwrap();
    assert!(error(child + inner, CHILD_NONE).contains("nodes"));
    let last = table[SECTION_NODES].bytes as usize / size_of::<BvhNode>() - 1;
    let leaf = child + last * size_of::<BvhNode>();
    let slot = (0..WIDTH).find(|&s| blob[leaf + s] != CHILD_NONE).unwrap();
    assert!(error(leaf + slot, CHILD_INNER).contains("hierarchy"));
    assert!(complete_bvh(&mut blob[..100].to_vec(), &mesh).is_err());
}

/// Six walls of two triangles each, around some thousand small ones.
#[test]
fn walls_are_set_apart() {
    let size = [8.0, 6.0, 3.0];
    let corner = |bits: usize| std::array::from_fn(|axis| size[axis] * (bits >> axis & 1) as f32);
    let mut triangles: Vec<Corners> = Vec::new();
    for axis in 0..3 {
        for side in [0, 1 << axis] {
            let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
            let [a, b, c, d] = [0, u, u | v, v].map(|bits| corner(side | bits));
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let mut random = Random(4);
    for _ in 0..4000 {
        let at = random.point();
        triangles
            .push(random.triangle(std::array::from_fn(|i| size[i] * (0.02 + 0.96 * at[i])), 0.05));
    }
    let mesh_blob = mesh_of(&triangles);
    let mesh = TileMesh::from_blob(&mesh_blob).unwrap();
    let blob = completed(&mesh, 1e-5);
    let view = BvhView::from_blob(&blob, &mesh, 1e-5).unwrap();
    let is_wall = |&triangle: &u32| triangle < 12;
    let mut blocks_of_walls = 0;
    for block in view.blocks {
        let lanes = block.global.iter().filter_map(|&global| local(&mesh, global));
        let walls = lanes.clone().filter(is_wall).count();
        if walls > 0 {
            // Whole walls, and nothing else.
            assert!(walls == lanes.count() && walls % 2 == 0);
            blocks_of_walls += 1;
        }
    }
    assert!(blocks_of_walls >= 5, "{blocks_of_walls}");
    // And none is below more than two nodes.
    let mut at_depth_three = Vec::new();
    let inner = |node: &BvhNode| {
        (
            node.nodes,
            node.child.iter().filter(|&&c| c != CHILD_NONE && c & CHILD_INNER != 0).count(),
        )
    };
    let (first, count) = inner(&view.nodes[0]);
    for child in first as usize..first as usize + count {
        let (first, count) = inner(&view.nodes[child]);
        for grandchild in first as usize..first as usize + count {
            at_depth_three.extend(below(&view, &mesh, grandchild, 1e-5, 3));
        }
    }
    assert!(at_depth_three.len() > 3000 && !at_depth_three.iter().any(is_wall));
}
