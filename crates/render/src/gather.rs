//! Final gathering: light that a surface gets from other surfaces, asked for by rays instead of read from its own photons
//! (Jensen 2001, section 9.3.1; irradiance kept at photons: Christensen 1999, "Faster Photon Map Global Illumination").
//!
//! A photon map blurs over the disc of its estimate. A gather ray looks at a surface from afar, where the blur averages
//! out: its own point is lit by what is really there, up to the corner. Every path from the lamps is found in exactly
//! one way. From the surface that the eye sees,
//!
//! - the lamp itself: shadow rays;
//! - the lamp over mirrors, gloss and glass alone: the caustic photons ([`crate::caustics`]), hence light
//!   that a gather ray meets where it begins, or the sky, counts nothing;
//! - all else: gather rays. They follow mirrors, gloss, panes and glass; at the first matter that they meet, the light from
//!   there is direct (one shadow ray), plus the photon map's.
//!
//! What is nearer than the disc of the estimate there would show the blur after all, in corners and under things; and on
//! things smaller than the disc, flux over its area is no irradiance, however far away they are
//! ([`enf_illumination::Irradiance::vague`]). Such a point sends a gather ray of its own instead, by roulette, and so on (Jensen 2001,
//! section 10.2.3). So there is no bias but the map's, of what is as large as a disc and seen from afar.
//!
//! Pictures that see the photon map directly send gather rays off from what is too small for it, by the same rule
//! ([`Shader::look_about`]).
//!
//! Gather rays are parked at portals like all others: which rooms are in memory, and when, does not matter.

use std::ops::Range;

use enf_layout::transit::{TRANSIT_GATHER, TransitRecord};
use enf_transport::flight::Surface;
use enf_transport::rng::{self, Purpose};
use enf_transport::scatter::{self, Lobes};
use enf_transport::vector;
use glam::Vec3;

use crate::caustics;
use crate::shade::{Products, Scratch, Shader};

impl Shader<'_> {
    /// Indirect light at a point that a camera ray has met: caustics, and gather rays.
    pub(crate) fn spread(
        &self,
        record: &TransitRecord,
        surface: &Surface,
        throughput: Vec3,
        lobes: &Lobes,
        scratch: &mut Scratch,
        products: &mut Products,
    ) {
        self.add_caustics(record, surface, throughput * lobes.diffuse, scratch);
        let context = self.context;
        // The pixel's rays are shared out among its first samples. What is seen in a mirror gets one of each.
        let (rays, weight) = if record.bounce > 0 {
            (record.photon..record.photon + 1, 1.0)
        } else if record.photon < context.samples {
            let (all, samples) = (u64::from(context.gather_rays), u64::from(context.samples));
            let until = |sample: u64| (sample * all / samples) as u32;
            let sample = u64::from(record.photon);
            (until(sample)..until(sample + 1), context.samples as f32 / context.gather_rays as f32)
        } else {
            (0..0, 0.0)
        };
        if record.bounce == 0 {
            let (film, pixel) = self.film_of(record);
            film.add_gather_rays(pixel, rays.end - rays.start);
        }
        let flux = throughput * lobes.diffuse * weight;
        self.gather_all(record, rays, surface, flux, lobes, scratch, products);
    }

    /// Indirect light at a point that a camera ray has met and of which the photon map knows too little: a gather ray for each of the pixel's
    /// first samples, and of what is seen in a mirror. Its caustics, which are of fewer photons than say anything, are left out.
    pub(crate) fn look_about(
        &self,
        record: &TransitRecord,
        surface: &Surface,
        throughput: Vec3,
        lobes: &Lobes,
        scratch: &mut Scratch,
        products: &mut Products,
    ) {
        // What further samples see is in the mean of the first ones.
        if record.bounce > 0 || record.photon < self.context.samples {
            let (flux, own) = (throughput * lobes.diffuse, record.photon..record.photon + 1);
            self.gather_all(record, own, surface, flux, lobes, scratch, products);
        }
    }

    /// Sends off the gather rays of these numbers, of one sequence over all samples of the pixel, scrambled per pixel and bounce.
    #[expect(clippy::too_many_arguments)]
    fn gather_all(
        &self,
        record: &TransitRecord,
        rays: Range<u32>,
        surface: &Surface,
        flux: Vec3,
        lobes: &Lobes,
        scratch: &mut Scratch,
        products: &mut Products,
    ) {
        let context = self.context;
        let (_, local) = context.pixel(record.light);
        let scramble = rng::block(context.seed, Purpose::Gather, local, 0, record.bounce, 0);
        for index in rays {
            let [x, y] = sobol(index);
            let u = [rng::unit(x ^ scramble[0]), rng::unit(y ^ scramble[1])];
            // The bounces of a gather ray are counted apart from those of the path that it comes from.
            let start = TransitRecord {
                light: record.light,
                photon: index,
                bounce: record.bounce.min(0xff) << 8,
                ..TransitRecord::default()
            };
            self.gather(start, surface, flux, lobes, u, scratch, products);
        }
    }

    /// What a gather ray has found at matter: the light that comes from there.
    pub(crate) fn gathered(
        &self,
        record: &TransitRecord,
        surface: &Surface,
        lobes: &Lobes,
        distance: f32,
        scratch: &mut Scratch,
        products: &mut Products,
    ) {
        let throughput = Vec3::from(record.flux);
        self.direct(record, surface, throughput, lobes, scratch, products);
        let Some((map, cache)) = &self.map else { return };
        let most = self.context.gather.radius.min(map.radius());
        let reflected = throughput * lobes.diffuse;
        let found = cache.estimate(
            map,
            surface.position,
            surface.normal,
            &self.context.gather,
            &self.portals,
            &mut scratch.gather,
        );
        // No photon within reach: a disc as wide as it may be, and dark.
        let radius = if found.radius > 0.0 { found.radius } else { most };
        if distance >= radius && !found.vague {
            let radiance = reflected * Vec3::from(found.rgb) * core::f32::consts::FRAC_1_PI;
            self.add_indirect(record, radiance);
            return;
        }
        // Too near for the disc of the estimate, or too small.
        self.add_caustics(record, surface, reflected, scratch);
        let (sum, total) = (reflected.dot(Vec3::ONE), throughput.dot(Vec3::ONE));
        let survival = (sum / total).min(scatter::MAX_SURVIVAL);
        let (_, local) = self.context.pixel(record.light);
        let u = rng::uniforms(
            self.context.seed,
            Purpose::Gather,
            local,
            record.photon,
            record.bounce,
            1,
        );
        // Written so that what is no number ends here.
        let goes_on = u[0] < survival;
        if goes_on {
            let start = TransitRecord {
                light: record.light,
                photon: record.photon,
                bounce: record.bounce.saturating_add(1),
                ..TransitRecord::default()
            };
            let flux = reflected / survival;
            self.gather(start, surface, flux, lobes, [u[1], u[2]], scratch, products);
        }
    }

    /// Sends a gather ray off: `flux` is what the eye gets of the mean radiance about the surface, `start` says whose
    /// the ray is.
    #[expect(clippy::too_many_arguments)]
    fn gather(
        &self,
        start: TransitRecord,
        surface: &Surface,
        flux: Vec3,
        lobes: &Lobes,
        u: [f32; 2],
        scratch: &mut Scratch,
        products: &mut Products,
    ) {
        let direction = vector::cosine(surface.normal, u[0], u[1]);
        let flux = match &lobes.coat {
            Some(coat) => flux * coat.admits(direction.dot(surface.normal)),
            None => flux,
        };
        if flux == Vec3::ZERO {
            return;
        }
        let origin = surface.origin;
        products.gathers += 1;
        let record = TransitRecord {
            origin: origin.to_array(),
            direction: direction.to_array(),
            flux: flux.to_array(),
            leaf: self.tile.bsp.locate_towards(origin.as_dvec3(), direction.as_dvec3()),
            flags: TRANSIT_GATHER,
            last_triangle: surface.triangle,
            ..start
        };
        self.send(record, scratch, products);
    }

    /// Adds what a surface reflects of caustics: `reflected` is its reflectance times the path's throughput.
    fn add_caustics(
        &self,
        record: &TransitRecord,
        surface: &Surface,
        reflected: Vec3,
        scratch: &mut Scratch,
    ) {
        let Some(map) = &self.caustics else { return };
        let radius = self.context.gather.radius;
        let (point, normal) = (surface.position, surface.normal);
        let found =
            caustics::irradiance(map, point, normal, radius, &self.portals, &mut scratch.gather);
        let radiance = reflected * found * core::f32::consts::FRAC_1_PI;
        if radiance != Vec3::ZERO {
            self.add_indirect(record, radiance);
        }
    }
}

/// The first two dimensions of Sobol's sequence as 32-bit fractions (Kollig and Keller 2002, "Efficient Multidimensional
/// Sampling").
fn sobol(index: u32) -> [u32; 2] {
    let (mut rest, mut column, mut y) = (index, 1u32 << 31, 0);
    while rest != 0 {
        if rest & 1 != 0 {
            y ^= column;
        }
        rest >>= 1;
        column ^= column >> 1;
    }
    [index.reverse_bits(), y]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every elementary box of a power of two of points holds exactly one (a (0, 2)-sequence), scrambled or not.
    #[test]
    fn directions_are_stratified() {
        for first in [0, 64, 192] {
            for (wide, high) in [(1, 64), (4, 16), (8, 8), (64, 1)] {
                let mut boxes = vec![0; 64];
                for index in first..first + 64 {
                    let [x, y] = sobol(index).map(|v| rng::unit(v ^ 0x9E37_79B9));
                    let (i, j) = ((x * wide as f32) as usize, (y * high as f32) as usize);
                    boxes[i * high + j] += 1;
                }
                assert!(boxes.iter().all(|&n| n == 1), "{first} {wide} {high}");
            }
        }
    }
}
