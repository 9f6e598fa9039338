//! Photons with the whole scene in memory: what a tracer does that has Embree and nothing to park, load or write.
//!
//! The same walks as `enf-trace` makes in a scene of Lambertian surfaces: photons of equal flux leave the lights by area and
//! cosine, a reflection is survived with the mean reflectance of what the photon carries, and every impact is stored, in 24 bytes. Random numbers,
//! flux and directions are done as cheaply as a tracer may that need not come to the same bits.
//!
//! `--write` writes a scene for the others instead; `benches/photons.sh` runs all of them.
#![deny(unsafe_code)]
// Modules are shared with `bench-embree`, which uses the rest of them.
#![allow(dead_code)]

mod clock;
mod embree;
mod number;
mod random;
mod room;
mod scene;
mod surfaces;

use std::f32::consts::TAU;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};

use clap::Parser;
use glam::Vec3;

use crate::embree::{Beam, Embree, EmbreeError, Found, Mesh, Quality};
use crate::random::Random;
use crate::scene::{Scene, SceneError, Vertices};
use crate::surfaces::{RADIANCE, Surfaces};

/// Photons of a scene through the real Embree, everything in memory: stored impacts a second.
#[derive(Debug, Parser)]
#[command(version)]
struct Args {
    /// PREFIX.vtx, .idx and .light, and, if they are there, PREFIX.mat and PREFIX_mats.rad; or roomN, or rooms32, which are drawn
    #[arg(value_name = "PREFIX")]
    scene: PathBuf,
    /// Photons to send off (k and M are thousands and millions)
    #[arg(long, value_parser = number::count, default_value = "1M")]
    photons: u64,
    /// Threads to trace with; the hierarchy is built with one
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1024))]
    threads: u32,
    /// Repetitions, each of which is printed
    #[arg(long, default_value_t = 1)]
    repetitions: u32,
    /// Follow sixteen photons at a time with rtcIntersect16, not one with rtcIntersect1
    #[arg(long)]
    packets: bool,
    /// Embree's shared library, or a folder that holds it
    #[arg(long, env = "EMBREE_LIBRARY", value_name = "PATH")]
    library: Option<PathBuf>,
    /// Write the scene to a folder (NAME.obj, .mtl and .toml for us, NAME.rad for Radiance) and measure nothing
    #[arg(long, value_name = "FOLDER")]
    write: Option<PathBuf>,
}

/// What can go wrong.
#[derive(Debug, thiserror::Error)]
enum Failure {
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error(transparent)]
    Embree(#[from] EmbreeError),
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("embree-photons: {failure}");
            ExitCode::FAILURE
        }
    }
}

/// What is kept of an impact, as large as the record of `enf-trace`.
#[derive(Clone, Copy)]
#[repr(C)]
struct Impact {
    position: [f32; 3],
    /// Red, green, blue and their common exponent.
    flux: [u8; 4],
    direction: u32,
    normal: u32,
}

const _: () = assert!(size_of::<Impact>() == 24);

/// A photon on its way.
struct Photon {
    random: Random,
    beam: Beam,
    flux: Vec3,
}

/// Photons that a thread takes at a time.
const CHUNK: u64 = 8192;
/// Above its triangle a reflected ray starts so high, m.
const LIFT: f32 = 1e-4;

struct Tracer<'a> {
    scene: &'a Scene,
    surfaces: &'a Surfaces,
    embree: &'a embree::Scene<'a>,
    /// Red, green and blue of each photon, W, at the start.
    flux: Vec3,
}

impl Tracer<'_> {
    fn start(&self, photon: u64) -> Photon {
        let mut random = Random::new(photon);
        let light = &self.scene.lights[(random.bits() % self.scene.lights.len() as u64) as usize];
        let normal = light.normal();
        let origin = light.at(random.unit(), random.unit()) + LIFT * normal;
        let direction = cosine(normal, &mut random);
        let beam =
            Beam { origin: origin.to_array(), direction: direction.to_array(), far: f32::INFINITY };
        Photon { random, beam, flux: self.flux }
    }

    /// Stores an impact; false when that was the photon's last.
    #[inline]
    fn meets(
        &self,
        photon: &mut Photon,
        hit: Option<(Found, [f32; 3])>,
        store: &mut Vec<Impact>,
    ) -> bool {
        let Some((found, normal)) = hit else { return false };
        let direction = Vec3::from_array(photon.beam.direction);
        let position = Vec3::from_array(photon.beam.origin) + found.t * direction;
        let normal = Vec3::from_array(normal).normalize();
        let normal = if normal.dot(direction) > 0.0 { -normal } else { normal };
        store.push(Impact {
            position: position.to_array(),
            flux: rgbe(photon.flux),
            direction: packed(direction),
            normal: packed(normal),
        });
        // Lamps come behind the scene's triangles, and are black.
        let Some(&material) = self.surfaces.of.get(found.triangle as usize) else { return false };
        let diffuse = Vec3::from_array(self.surfaces.materials[material as usize].diffuse);
        let reflected = photon.flux * diffuse;
        let survives = (reflected.element_sum() / photon.flux.element_sum()).min(0.98);
        if photon.random.unit() as f32 >= survives {
            return false;
        }
        photon.flux = reflected / survives;
        photon.beam.origin = (position + LIFT * normal).to_array();
        photon.beam.direction = cosine(normal, &mut photon.random).to_array();
        true
    }

    fn singly(&self, photons: std::ops::Range<u64>, store: &mut Vec<Impact>) {
        for photon in photons {
            let mut photon = self.start(photon);
            loop {
                let hit = self.embree.meet(&photon.beam);
                if !self.meets(&mut photon, hit, store) {
                    break;
                }
            }
        }
    }

    /// Sixteen at a time; whoever has ended makes way for the next.
    fn in_packets(&self, mut photons: std::ops::Range<u64>, store: &mut Vec<Impact>) {
        let mut flying: Vec<Photon> = Vec::with_capacity(16);
        let (mut beams, mut hits) = (Vec::with_capacity(16), Vec::with_capacity(16));
        loop {
            while flying.len() < 16
                && let Some(photon) = photons.next()
            {
                flying.push(self.start(photon));
            }
            if flying.is_empty() {
                return;
            }
            beams.clear();
            beams.extend(flying.iter().map(|photon| photon.beam));
            hits.clear();
            self.embree.meet16(&beams, |hit| hits.push(hit));
            let mut hits = hits.iter();
            flying.retain_mut(|photon| self.meets(photon, hits.next().copied().flatten(), store));
        }
    }
}

/// A direction about a normal, by the cosine (Duff and others 2017, Building an Orthonormal Basis, Revisited).
#[inline]
fn cosine(n: Vec3, random: &mut Random) -> Vec3 {
    let (u, angle) = (random.unit() as f32, TAU * random.unit() as f32);
    let (r, z) = (u.sqrt(), (1.0 - u).sqrt());
    let sign = 1f32.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    let t = Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x);
    let q = Vec3::new(b, sign + n.y * n.y * a, -n.y);
    let (sin, cos) = angle.sin_cos();
    t * (r * cos) + q * (r * sin) + n * z
}

/// Ten bits and a half for each axis.
#[inline]
fn packed(d: Vec3) -> u32 {
    let part = |x: f32, most: f32| ((x + 1.0) * most) as u32;
    part(d.x, 1023.0) << 21 | part(d.y, 511.0) << 11 | part(d.z, 511.0)
}

/// Mantissas of eight bits and the largest exponent (Ward 1991, Real Pixels).
#[inline]
fn rgbe(flux: Vec3) -> [u8; 4] {
    let exponent = (flux.max_element().to_bits() >> 23) as i32 - 126;
    let scale = f32::from_bits(((127 + 8 - exponent) as u32) << 23);
    let part = |x: f32| (x * scale) as u8;
    [part(flux.x), part(flux.y), part(flux.z), (exponent + 128) as u8]
}

/// The lights as triangles behind the others: they are in the way, as lamps are.
fn with_lamps(scene: &Scene) -> (Vertices, Vec<[u32; 3]>) {
    let (mut vertices, mut triangles) = (scene.vertices.list().to_vec(), scene.triangles.clone());
    for light in &scene.lights {
        let first = vertices.len() as u32;
        for (s, t) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            vertices.push(light.at(s, t).to_array());
        }
        triangles.extend([[0, 1, 2], [0, 2, 3]].map(|t| t.map(|v: u32| v + first)));
    }
    (Vertices::new(vertices), triangles)
}

fn run(args: &Args) -> Result<(), Failure> {
    let drawn = args.scene.to_str().and_then(room::Plan::named);
    let (scene, surfaces) = match drawn {
        Some(plan) => {
            let scene = plan.draw();
            let surfaces = Surfaces::grey(&scene);
            (scene, surfaces)
        }
        None => {
            let scene = Scene::read(&args.scene)?;
            let surfaces = Surfaces::read(&args.scene, &scene)?;
            (scene, surfaces)
        }
    };
    if let Some(folder) = &args.write {
        return Ok(surfaces.write(&scene, folder)?);
    }
    let embree = Embree::load(args.library.as_deref())?;
    let (vertices, triangles) = with_lamps(&scene);
    let device = embree.device()?;
    let mesh = Mesh::new(&vertices, &triangles)?;
    let (built, build) = clock::time(|| embree.build(&device, mesh, Quality::Medium));
    let built = built?;
    let area: f32 = scene.lights.iter().map(|light| light.u.cross(light.v).length()).sum();
    let flux = std::f32::consts::PI * RADIANCE * area / args.photons as f32;
    let tracer =
        Tracer { scene: &scene, surfaces: &surfaces, embree: &built, flux: Vec3::splat(flux) };
    // Touched before anything is timed: new pages are no part of the walks.
    let room = (args.photons as usize * 4 / args.threads as usize).max(1 << 16);
    let blank = Impact { position: [0.0; 3], flux: [1; 4], direction: 1, normal: 1 };
    let mut stores: Vec<Vec<Impact>> = (0..args.threads).map(|_| vec![blank; room]).collect();
    for _ in 0..args.repetitions {
        stores.iter_mut().for_each(Vec::clear);
        let next = AtomicU64::new(0);
        let ((), took) = clock::time(|| {
            std::thread::scope(|scope| {
                for store in &mut stores {
                    let (next, tracer) = (&next, &tracer);
                    scope.spawn(move || {
                        loop {
                            let first = next.fetch_add(CHUNK, Ordering::Relaxed);
                            if first >= args.photons {
                                return;
                            }
                            let photons = first..(first + CHUNK).min(args.photons);
                            match args.packets {
                                true => tracer.in_packets(photons, store),
                                false => tracer.singly(photons, store),
                            }
                        }
                    });
                }
            });
        });
        let stored: usize = stores.iter().map(Vec::len).sum();
        println!(
            "stored {stored} wall {:.4} cpu {:.4} build {:.4}",
            took.wall, took.cpu, build.wall
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flux_is_packed_with_its_largest_exponent() {
        for flux in [Vec3::new(1.0, 0.5, 0.25), Vec3::new(3e-5, 2.9e-5, 1e-6)] {
            let [r, g, b, e] = rgbe(flux);
            assert!(r >= 128);
            let back =
                Vec3::new(r.into(), g.into(), b.into()) * (i32::from(e) as f32 - 136.0).exp2();
            assert!((back - flux).abs().max_element() <= flux.x / 128.0, "{flux} {back}");
        }
    }

    #[test]
    fn directions_are_about_the_normal() {
        let mut random = Random::new(5);
        for normal in [Vec3::Z, Vec3::NEG_Z, Vec3::new(0.6, -0.64, 0.48)] {
            let mean =
                (0..10_000).map(|_| cosine(normal, &mut random).dot(normal)).sum::<f32>() / 1e4;
            // Of a cosine's deviation of 0.236 in 10,000: more than 4 of them.
            assert!((mean - 2.0 / 3.0).abs() < 0.01, "{mean}");
        }
    }
}
