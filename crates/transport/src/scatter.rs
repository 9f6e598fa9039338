//! What a surface does with light: Lambert, mirror, and thin panes that let the ray go straight on.
//!
//! Russian roulette chooses *one* of absorption and the lobes, on the flux's sum over the channels, so
//! that a photon keeps its total flux (Jensen 2001, section 5.2; survival never above 0.98).

use enf_layout::material::MaterialRecord;
use glam::Vec3;

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
    /// The mirror direction.
    Mirror(Vec3),
    /// Straight on: the same ray, further along.
    Transmitted,
}

/// Reflectances and transmittance at one angle, per channel; they sum to at most 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lobes {
    /// Lambert reflectance.
    pub diffuse: Vec3,
    /// Mirror reflectance.
    pub mirror: Vec3,
    /// Straight transmittance.
    pub transmitted: Vec3,
}

/// Unpolarised reflectance of one smooth interface (Fresnel), light arriving from the thinner side at
/// cosine `cos`.
pub fn fresnel(cos: f32, index: f32) -> f32 {
    let sin2 = ((1.0 - cos * cos) / (index * index)).max(0.0);
    if sin2 >= 1.0 {
        return 1.0;
    }
    let inner = (1.0 - sin2).sqrt();
    let parallel = (index * cos - inner) / (index * cos + inner);
    let perpendicular = (cos - index * inner) / (cos + index * inner);
    (parallel * parallel + perpendicular * perpendicular) * 0.5
}

/// Lobes of a material where a ray meets it at `cos` to the normal (positive).
///
/// A see-through sheet is one interface of a pane: a pane modelled as a thin box reflects at both of its
/// faces, inter-reflections included, as the ray tracer meets them; its two parallel faces refract a ray
/// back to its old direction, so that "straight on" is exact but for the offset of some millimetres.
pub fn lobes(material: &MaterialRecord, cos: f32) -> Lobes {
    let diffuse = Vec3::from(material.diffuse);
    let transmitted = Vec3::from(material.transmission);
    if transmitted.max_element() > 0.0 && material.index > 1.0 {
        let r = fresnel(cos, material.index);
        return Lobes {
            diffuse: diffuse * (1.0 - r),
            mirror: Vec3::splat(r),
            transmitted: transmitted * (1.0 - r),
        };
    }
    Lobes { diffuse, mirror: Vec3::from(material.specular), transmitted }
}

/// Whether impacts on the material are stored in photon maps: everything but pure mirrors and panes.
pub fn stores_impacts(material: &MaterialRecord) -> bool {
    let specular = Vec3::from(material.specular).max_element();
    let transmitted = Vec3::from(material.transmission).max_element();
    Vec3::from(material.diffuse).max_element() > 0.0 || (specular <= 0.0 && transmitted <= 0.0)
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
    let weight = |c: Vec3| (flux * c).dot(Vec3::ONE) / total;
    let (d, m, t) = (weight(lobes.diffuse), weight(lobes.mirror), weight(lobes.transmitted));
    let sum = d + m + t;
    if sum <= 0.0 {
        return (Event::Absorbed, Vec3::ZERO);
    }
    let scale = if sum > MAX_SURVIVAL { MAX_SURVIVAL / sum } else { 1.0 };
    let (pd, pm, pt) = (d * scale, m * scale, t * scale);
    let x = u[0];
    if x < pd {
        (Event::Diffuse(vector::cosine(normal, u[1], u[2])), flux * lobes.diffuse / pd)
    } else if x < pd + pm {
        let reflected = direction - normal * (2.0 * direction.dot(normal));
        (Event::Mirror(reflected.normalize()), flux * lobes.mirror / pm)
    } else if x < pd + pm + pt {
        (Event::Transmitted, flux * lobes.transmitted / pt)
    } else {
        (Event::Absorbed, Vec3::ZERO)
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
                diffuse: Vec3::new(r, g, b), mirror: Vec3::splat(m), transmitted: Vec3::ZERO,
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
            let lobes = Lobes { diffuse: Vec3::new(r, g, 0.3), mirror: Vec3::ZERO, transmitted: Vec3::ZERO };
            let flux = Vec3::new(1.0, 2.0, 0.5);
            let (event, after) = scatter(&lobes, -Vec3::Z, Vec3::Z, flux, [u, 0.1, 0.2]);
            if event != Event::Absorbed {
                prop_assert!((after.dot(Vec3::ONE) - 3.5).abs() < 1e-4);
            }
        }
    }
}
