//! What a surface does with light: Lambert, mirror, gloss, thin panes that let the ray go straight on, solid glass
//! that bends it.
//!
//! Russian roulette chooses *one* of absorption and the lobes, on the flux's sum over the channels, so
//! that a photon keeps its total flux (Jensen 2001, section 5.2; survival never above 0.98). Where a lobe's weight
//! depends on the direction that is drawn from it (gloss, and matter below gloss), directions are drawn first and
//! roulette chooses among what was drawn: that is as unbiased, and keeps the flux as well.

use enf_layout::material::{MATERIAL_GLOSS, MATERIAL_SOLID, MaterialRecord};
use enf_layout::transit::{TRANSIT_ACROSS, TRANSIT_ALONG};
use glam::Vec3;

use crate::gloss::{Coat, Glossy};
use crate::vector;

/// Survival is never more probable than this, however white a room is; survivors are compensated.
pub const MAX_SURVIVAL: f32 = 0.98;

/// What Russian roulette chose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// The path ends here.
    Absorbed,
    /// A new direction from a Lambert lobe on the side that was hit.
    Diffuse(Vec3),
    /// The mirror direction, or one about it.
    Mirror(Vec3),
    /// Straight on: the same ray, further along.
    Transmitted,
    /// Through the surface into or out of solid glass, bent.
    Refracted(Vec3),
}

/// How a ray meets a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Met {
    /// Cosine to the normal on the side that was hit, positive.
    pub cos: f32,
    /// The front was hit.
    pub front: bool,
    /// How far the ray has come since it started, m.
    pub length: f32,
    /// What the texture says there; white without one.
    pub texel: Vec3,
    /// How the light swings, inside solid glass.
    pub swings: Swings,
}

/// Polarisation, as far as it is followed: light that has entered solid glass is one or the other. Without it, a pane seen
/// at 80 degrees would pass 4 % too little: what the first face lets through, the second one does too.
///
/// The plane of incidence stays the same in a slab, a prism of it and a sphere; in other things it turns, and the mixing
/// that it would cause is left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Swings {
    /// Either way alike.
    #[default]
    Anyhow,
    /// Across the plane of incidence (s).
    Across,
    /// Along it (p).
    Along,
}

impl Swings {
    /// As a ray in transit says.
    pub fn of(flags: u16) -> Self {
        match flags & (TRANSIT_ACROSS | TRANSIT_ALONG) {
            TRANSIT_ACROSS => Self::Across,
            TRANSIT_ALONG => Self::Along,
            _ => Self::Anyhow,
        }
    }
}

/// Reflectances and transmittance at one angle, per channel; they sum to at most 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lobes {
    /// Lambert reflectance. Below a coat: reflectance for light from all around, to be multiplied by
    /// [`Coat::admits`] for light from one direction.
    pub diffuse: Vec3,
    /// Mirror reflectance.
    pub mirror: Vec3,
    /// Straight transmittance.
    pub transmitted: Vec3,
    /// Transmittance into, or out of, solid glass.
    pub refracted: Vec3,
    /// Refractive index on the ray's side over that beyond, for what is refracted.
    pub eta: f32,
    /// Share of what is refracted into solid glass that swings across the plane of incidence; 0 for what leaves it.
    pub across: f32,
    /// The gloss on the matter. A rough one is a lobe of its own; a smooth one is in `mirror`.
    pub coat: Option<Coat>,
}

impl Lobes {
    /// A surface that only absorbs.
    pub const BLACK: Self = Self {
        diffuse: Vec3::ZERO,
        mirror: Vec3::ZERO,
        transmitted: Vec3::ZERO,
        refracted: Vec3::ZERO,
        eta: 1.0,
        across: 0.0,
        coat: None,
    };

    /// A ray's flags after it was refracted: which way its light swings inside is chosen by a uniform number `u`.
    pub fn swung(&self, flags: u16, u: f32) -> u16 {
        let flags = flags & !(TRANSIT_ACROSS | TRANSIT_ALONG);
        if self.across <= 0.0 {
            flags
        } else if u < self.across {
            flags | TRANSIT_ACROSS
        } else {
            flags | TRANSIT_ALONG
        }
    }

    /// The gloss, if it is rough.
    pub fn gloss(&self) -> Option<&Coat> {
        self.coat.as_ref().filter(|c| !c.is_smooth())
    }

    /// What the gloss or the mirror does with a ray along `direction`: a direction, its weight, and the density with which
    /// a gloss draws it (0 for a mirror). `None` where nothing is reflected.
    pub fn reflect(&self, direction: Vec3, normal: Vec3, u: [f32; 2]) -> Option<Glossy> {
        match self.gloss() {
            Some(coat) => coat.sample(normal, -direction, u[0], u[1]),
            None if self.mirror == Vec3::ZERO => None,
            None => {
                let direction = direction - normal * (2.0 * direction.dot(normal));
                let direction = direction.normalize();
                Some(Glossy { direction, weight: self.mirror, density: 0.0 })
            }
        }
    }

    /// The direction beyond the surface of what is refracted, by Snell's law.
    pub fn refract(&self, direction: Vec3, normal: Vec3) -> Vec3 {
        let cos = -direction.dot(normal);
        let beyond = (1.0 - self.eta * self.eta * (1.0 - cos * cos)).max(0.0).sqrt();
        (direction * self.eta + normal * (self.eta * cos - beyond)).normalize()
    }
}

/// Unpolarised reflectance of one smooth interface (Fresnel), light arriving at cosine `cos`; `index` is the refractive
/// index beyond over that on the ray's side. 1 where reflection is total.
pub fn fresnel(cos: f32, index: f32) -> f32 {
    let [across, along] = fresnel_parts(cos, index);
    (along + across) * 0.5
}

/// As [`fresnel`], of light that swings across the plane of incidence (s), and along it (p).
pub fn fresnel_parts(cos: f32, index: f32) -> [f32; 2] {
    let sin2 = ((1.0 - cos * cos) / (index * index)).max(0.0);
    if sin2 >= 1.0 {
        return [1.0; 2];
    }
    let inner = (1.0 - sin2).sqrt();
    let along = (index * cos - inner) / (index * cos + inner);
    let across = (cos - index * inner) / (cos + index * inner);
    [across * across, along * along]
}

/// Lobes of a material where a ray meets it.
///
/// A see-through sheet is one interface of a pane: a pane modelled as a thin box reflects at both of its
/// faces, inter-reflections included, as the ray tracer meets them; its two parallel faces refract a ray
/// back to its old direction, so that "straight on" is exact but for the offset of some millimetres.
///
/// Solid glass is met from outside at its front and from inside at its back. What was absorbed inside since the ray
/// started (Beer and Lambert) is settled there.
pub fn lobes(material: &MaterialRecord, met: &Met) -> Lobes {
    if material.flags & MATERIAL_SOLID != 0 {
        return solid(material, met);
    }
    let diffuse = Vec3::from(material.diffuse) * met.texel;
    if let Some(coat) = Coat::of(material) {
        let mirror = if coat.is_smooth() { coat.fresnel(met.cos) } else { Vec3::ZERO };
        let diffuse = diffuse * (Vec3::ONE - coat.albedo(met.cos));
        return Lobes { diffuse, mirror, coat: Some(coat), ..Lobes::BLACK };
    }
    let transmitted = Vec3::from(material.transmission);
    if transmitted.max_element() > 0.0 && material.index > 1.0 {
        let r = fresnel(met.cos, material.index);
        return Lobes {
            diffuse: diffuse * (1.0 - r),
            mirror: Vec3::splat(r),
            transmitted: transmitted * (1.0 - r),
            ..Lobes::BLACK
        };
    }
    Lobes { diffuse, mirror: Vec3::from(material.specular), transmitted, ..Lobes::BLACK }
}

fn solid(material: &MaterialRecord, met: &Met) -> Lobes {
    let index = material.index.max(1.0);
    let (beyond, arrives) = if met.front {
        (index, Vec3::ONE)
    } else {
        let [r, g, b] = material.absorption.map(|a| libm::expf(-a.max(0.0) * met.length));
        (1.0 / index, Vec3::new(r, g, b))
    };
    let [across, along] = fresnel_parts(met.cos, beyond);
    let passes = (1.0 - across) + (1.0 - along);
    let r = match met.swings {
        Swings::Across if !met.front => across,
        Swings::Along if !met.front => along,
        _ => 0.5 * (across + along),
    };
    Lobes {
        mirror: arrives * r,
        refracted: arrives * Vec3::from(material.transmission) * (1.0 - r),
        eta: 1.0 / beyond,
        across: if met.front && passes > 0.0 { (1.0 - across) / passes } else { 0.0 },
        ..Lobes::BLACK
    }
}

/// Whether impacts on the material are stored in photon maps: everything but pure mirrors, metals and glass.
pub fn stores_impacts(material: &MaterialRecord) -> bool {
    let specular = Vec3::from(material.specular).max_element();
    let transmitted = Vec3::from(material.transmission).max_element();
    Vec3::from(material.diffuse).max_element() > 0.0 || (specular <= 0.0 && transmitted <= 0.0)
}

/// Whether a Lambert lobe, textured or not, is all that a material has: no gloss, no mirror, nothing that light goes through.
pub fn is_bare(material: &MaterialRecord) -> bool {
    material.flags & (MATERIAL_GLOSS | MATERIAL_SOLID) == 0
        && material.specular == [0.0; 3]
        && material.transmission == [0.0; 3]
}

/// Russian roulette among absorption and the lobes. `normal` is the unit normal on the side that was hit,
/// `u` three uniform numbers. Returns what happens and the flux that goes on (same unit as `flux`).
pub fn scatter(
    lobes: &Lobes,
    direction: Vec3,
    normal: Vec3,
    flux: Vec3,
    u: [f32; 3],
) -> (Event, Vec3) {
    let total = flux.x + flux.y + flux.z;
    if total <= 0.0 {
        return (Event::Absorbed, Vec3::ZERO);
    }
    let mut diffuse = lobes.diffuse;
    let mut below = None;
    if let Some(coat) = &lobes.coat
        && diffuse != Vec3::ZERO
    {
        let new = vector::cosine(normal, u[1], u[2]);
        diffuse *= coat.admits(normal.dot(new));
        below = Some(new);
    }
    let reflected = lobes.reflect(direction, normal, [u[1], u[2]]);
    let mirror = reflected.map_or(Vec3::ZERO, |r| r.weight);
    let weight = |c: Vec3| (flux * c).dot(Vec3::ONE) / total;
    let (d, m) = (weight(diffuse), weight(mirror));
    let (t, r) = (weight(lobes.transmitted), weight(lobes.refracted));
    let sum = d + m + t + r;
    if sum <= 0.0 {
        return (Event::Absorbed, Vec3::ZERO);
    }
    let scale = if sum > MAX_SURVIVAL { MAX_SURVIVAL / sum } else { 1.0 };
    let (pd, pm, pt, pr) = (d * scale, m * scale, t * scale, r * scale);
    let x = u[0];
    if x < pd {
        let new = below.unwrap_or_else(|| vector::cosine(normal, u[1], u[2]));
        return (Event::Diffuse(new), flux * diffuse / pd);
    }
    match reflected {
        Some(reflected) if x < pd + pm => (Event::Mirror(reflected.direction), flux * mirror / pm),
        _ if x < pd + pm + pt => (Event::Transmitted, flux * lobes.transmitted / pt),
        _ if x < pd + pm + pt + pr => {
            (Event::Refracted(lobes.refract(direction, normal)), flux * lobes.refracted / pr)
        }
        _ => (Event::Absorbed, Vec3::ZERO),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn fresnel_closed_forms() {
        // Normal incidence: ((n-1)/(n+1))^2; Brewster: the parallel part vanishes; grazing: 1.
        assert!((fresnel(1.0, 1.5) - 0.04).abs() < 1e-6);
        let brewster = libm::atanf(1.5);
        let rs = libm::powf(libm::cosf(2.0 * brewster), 2.0);
        assert!((fresnel(libm::cosf(brewster), 1.5) - 0.5 * rs).abs() < 1e-5);
        assert!((fresnel(1e-6, 1.5) - 1.0).abs() < 1e-3);
    }

    proptest! {
        /// Expectation of the outgoing flux, over Russian roulette, is flux times the lobes' sum.
        #[test]
        fn roulette_is_unbiased_in_every_channel(
            r in 0.0f32..0.9, g in 0.0f32..0.9, b in 0.0f32..0.9, m in 0.0f32..0.1,
            fr in 0.1f32..2.0, fg in 0.1f32..2.0, fb in 0.1f32..2.0,
        ) {
            let lobes = Lobes {
                diffuse: Vec3::new(r, g, b), mirror: Vec3::splat(m), ..Lobes::BLACK
            };
            let flux = Vec3::new(fr, fg, fb);
            let n = 20_000;
            let mut sum = Vec3::ZERO;
            for i in 0..n {
                let u = (i as f32 + 0.5) / n as f32;
                sum += scatter(&lobes, -Vec3::Z, Vec3::Z, flux, [u, 0.3, 0.6]).1 / n as f32;
            }
            let expected = flux * (lobes.diffuse + lobes.mirror);
            prop_assert!((sum - expected).abs().max_element() < 2e-3 * flux.max_element(), "{sum} {expected}");
        }

        #[test]
        fn total_flux_is_kept_below_the_cap(r in 0.05f32..0.9, g in 0.05f32..0.9, u in 0.0f32..1.0) {
            let lobes = Lobes { diffuse: Vec3::new(r, g, 0.3), ..Lobes::BLACK };
            let flux = Vec3::new(1.0, 2.0, 0.5);
            let (event, after) = scatter(&lobes, -Vec3::Z, Vec3::Z, flux, [u, 0.1, 0.2]);
            if event != Event::Absorbed {
                prop_assert!((after.dot(Vec3::ONE) - 3.5).abs() < 1e-4);
            }
        }
    }
}
