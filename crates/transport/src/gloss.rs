//! Gloss: light that leaves a rough surface about the mirror direction, and what it leaves to the matter below.
//!
//! The lobe is that of microfacets with the GGX distribution of slopes and Smith's shadowing, height-correlated
//! (Walter et al. 2007, "Microfacet Models for Refraction through Rough Surfaces"; Heitz 2014, "Understanding the
//! Masking-Shadowing Function", section 5.3), with Fresnel's reflectance after Schlick (1994). Directions are drawn by
//! the normals that are visible (Heitz 2018, "Sampling the GGX Distribution of Visible Normals", JCGT 7(4)): a
//! sample's weight is never above the Fresnel reflectance.
//!
//! Matter below the gloss gets what the gloss does not reflect, on the way in and on the way out (Kelemen and
//! Szirmay-Kalos 2001, "A Microfacet Based Coupled Specular-Matte BRDF Model", section 4):
//!
//! `f = (kd / pi) (1 - E(in)) (1 - E(out)) / (1 - mean of E)`
//!
//! with the gloss's directional albedo `E`. That is reciprocal, and seen from any angle the whole surface reflects
//! `E + kd (1 - E)`: never more than arrives. Light that bounces between facets is lost, as in every model with a single
//! scattering: a white metal of roughness 0.5 (alpha 0.25) keeps 88 %, one of roughness 1 keeps 41.

use std::sync::OnceLock;

use enf_layout::material::{MATERIAL_GLOSS, MaterialRecord, SMOOTHEST_GLOSS as SMOOTHEST};
use glam::Vec3;

use crate::vector;

/// Steps of the table along the cosine, uniform in its root: grazing angles are where albedos change.
const COSINES: usize = 64;
/// Steps along alpha, uniform in its root.
const ALPHAS: usize = 48;
/// Samples of each place of the table.
const LATTICE: [u32; 2] = [610, 377];
/// Added to tabulated albedos, so that what is interpolated is not below the truth: gloss and matter together must not
/// reflect more than arrives.
const SAFE: f32 = 4e-3;

/// The gloss of a material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coat {
    /// Reflectance at normal incidence.
    f0: Vec3,
    /// GGX roughness alpha; 0 for a mirror.
    alpha: f32,
    /// Directional albedo, averaged over directions by cosine.
    mean: Vec3,
}

/// A direction that was drawn from a lobe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Glossy {
    /// Unit direction, above the surface.
    pub direction: Vec3,
    /// The lobe times the cosine, divided by the density: at most 1.
    pub weight: Vec3,
    /// Density of the direction, 1/sr.
    pub density: f32,
}

/// Schlick's share of grazing reflectance at the cosine to the facet.
fn schlick(cos: f32) -> f32 {
    let x = (1.0 - cos).clamp(0.0, 1.0);
    (x * x) * (x * x) * x
}

/// Smith's Lambda: facets hidden per facet seen, for GGX at cosine `cos`.
fn hidden(cos: f32, alpha: f32) -> f32 {
    let c2 = cos * cos;
    let tan2 = (1.0 - c2).max(0.0) / c2.max(1e-12);
    0.5 * ((1.0 + alpha * alpha * tan2).sqrt() - 1.0)
}

/// A visible normal, in the frame (x along the view's shadow, y, normal), of a view at `cos`, from two uniform numbers
/// (Heitz 2018, listing 1, for one alpha).
fn visible_normal(cos: f32, alpha: f32, u1: f32, u2: f32) -> Vec3 {
    let sin = (1.0 - cos * cos).max(0.0).sqrt();
    let view = Vec3::new(alpha * sin, 0.0, cos).normalize();
    // The first axis square to the view is y, the second leans with the view.
    let lean = Vec3::new(-view.z, 0.0, view.x);
    let radius = u1.sqrt();
    let (s, c) = libm::sincosf(core::f32::consts::TAU * u2);
    let across = radius * c;
    let half = 0.5 * (1.0 + view.z);
    let along = (1.0 - half) * (1.0 - across * across).max(0.0).sqrt() + half * (radius * s);
    let height = (1.0 - across * across - along * along).max(0.0).sqrt();
    let n = Vec3::Y * across + lean * along + view * height;
    Vec3::new(alpha * n.x, alpha * n.y, n.z.max(1e-6)).normalize()
}

/// Albedos by angle and roughness: `[share of f0, share of white]`, then their means over angles.
struct Albedos {
    by_angle: Vec<[f32; 2]>,
    mean: [[f32; 2]; ALPHAS],
}

fn alpha_of(row: usize) -> f32 {
    let least = SMOOTHEST.sqrt();
    let root = least + (1.0 - least) * row as f32 / (ALPHAS - 1) as f32;
    root * root
}

impl Albedos {
    /// The table is made once, when the first material with gloss is met: two million samples of the lobe, the same on every
    /// machine.
    fn get() -> &'static Self {
        static TABLE: OnceLock<Albedos> = OnceLock::new();
        TABLE.get_or_init(Self::new)
    }

    fn new() -> Self {
        let mut by_angle = Vec::with_capacity(ALPHAS * COSINES);
        let mut mean = [[0.0f32; 2]; ALPHAS];
        for (row, mean) in mean.iter_mut().enumerate() {
            for column in 0..COSINES {
                let root = column as f32 / (COSINES - 1) as f32;
                let [grey, white] = albedo_by_sum((root * root).max(1e-5), alpha_of(row), LATTICE);
                let (grey, white) = (grey as f32, white as f32);
                by_angle.push([grey, (white + SAFE).min(1.0 - grey)]);
            }
            // The integral of what is interpolated: linear in the cosine's root `m`, times 4 m^3.
            let values = &by_angle[row * COSINES..];
            let mut sum = [0.0f64; 2];
            let step = 1.0 / (COSINES - 1) as f64;
            for i in 0..COSINES - 1 {
                let (a, b) = (i as f64 * step, (i + 1) as f64 * step);
                let (a4, b4) = ((a * a) * (a * a), (b * b) * (b * b));
                let (cubes, fourths) = (b4 - a4, 0.8 * (b4 * b - a4 * a));
                for k in 0..2 {
                    let slope = f64::from(values[i + 1][k] - values[i][k]) / step;
                    let base = f64::from(values[i][k]) - slope * a;
                    sum[k] += base * cubes + slope * fourths;
                }
            }
            *mean = sum.map(|v| v as f32);
        }
        Self { by_angle, mean }
    }

    /// The row below `alpha`, and how far it is to the next.
    fn row(alpha: f32) -> (usize, f32) {
        let least = SMOOTHEST.sqrt();
        let place = (alpha.sqrt() - least) / (1.0 - least) * (ALPHAS - 1) as f32;
        let place = place.clamp(0.0, (ALPHAS - 1) as f32);
        let row = (place as usize).min(ALPHAS - 2);
        (row, place - row as f32)
    }

    fn at(&self, cos: f32, alpha: f32) -> [f32; 2] {
        let (row, down) = Self::row(alpha);
        let place = cos.clamp(0.0, 1.0).sqrt() * (COSINES - 1) as f32;
        let column = (place as usize).min(COSINES - 2);
        let right = place - column as f32;
        let here = |row: usize, k: usize| {
            let at = row * COSINES + column;
            self.by_angle[at][k] * (1.0 - right) + self.by_angle[at + 1][k] * right
        };
        [0, 1].map(|k| here(row, k) * (1.0 - down) + here(row + 1, k) * down)
    }

    fn mean(&self, alpha: f32) -> [f32; 2] {
        let (row, down) = Self::row(alpha);
        [0, 1].map(|k| self.mean[row][k] * (1.0 - down) + self.mean[row + 1][k] * down)
    }
}

/// Albedo of the lobe at a cosine, as the mean of a Fibonacci lattice of samples (`n` and the number before it in the
/// sequence): the shares of `f0` and of white.
fn albedo_by_sum(cos: f32, alpha: f32, [n, step]: [u32; 2]) -> [f64; 2] {
    let sin = (1.0 - cos * cos).max(0.0).sqrt();
    let view = Vec3::new(sin, 0.0, cos);
    let mut sum = [0.0f64; 2];
    for i in 0..n {
        let u1 = (i as f32 + 0.5) / n as f32;
        let u2 = ((i * step % n) as f32 + 0.5) / n as f32;
        let half = visible_normal(cos, alpha, u1, u2);
        let along = view.dot(half);
        let out = half * (2.0 * along) - view;
        if along <= 0.0 || out.z <= 0.0 {
            continue;
        }
        let (seen, lit) = (hidden(cos, alpha), hidden(out.z, alpha));
        let weight = f64::from((1.0 + seen) / (1.0 + seen + lit));
        let white = f64::from(schlick(along));
        sum[0] += weight * (1.0 - white);
        sum[1] += weight * white;
    }
    sum.map(|s| s / f64::from(n))
}

impl Coat {
    /// The gloss of a material, if it has one.
    pub fn of(material: &MaterialRecord) -> Option<Self> {
        (material.flags & MATERIAL_GLOSS != 0)
            .then(|| Self::new(Vec3::from(material.specular), material.roughness))
    }

    /// A coat of reflectance `f0` (0 to 1) at normal incidence and GGX roughness `alpha` (0 to 1).
    pub fn new(f0: Vec3, alpha: f32) -> Self {
        let f0 = f0.clamp(Vec3::ZERO, Vec3::ONE);
        let alpha = if alpha >= SMOOTHEST { alpha.min(1.0) } else { 0.0 };
        let [grey, white] = if alpha > 0.0 {
            Albedos::get().mean(alpha)
        } else {
            // The mean of Schlick's fifth power by cosine is 1/21.
            [20.0 / 21.0, 1.0 / 21.0]
        };
        Self { f0, alpha, mean: f0 * grey + Vec3::splat(white) }
    }

    /// Whether it is a mirror.
    pub fn is_smooth(&self) -> bool {
        self.alpha == 0.0
    }

    /// Fresnel reflectance of a facet that is met at cosine `cos`.
    pub fn fresnel(&self, cos: f32) -> Vec3 {
        self.f0 + (Vec3::ONE - self.f0) * schlick(cos)
    }

    /// Directional albedo: what the gloss alone reflects of light from cosine `cos`, from 0 to 1 and rather too large
    /// than too small: by 0.012 at most, and 0.03 within a degree of grazing.
    pub fn albedo(&self, cos: f32) -> Vec3 {
        if self.is_smooth() {
            return self.fresnel(cos);
        }
        let [grey, white] = Albedos::get().at(cos, self.alpha);
        self.f0 * grey + Vec3::splat(white)
    }

    /// How much of light from cosine `cos` reaches the matter below, compared with light from all around: 1 on average
    /// over directions by cosine.
    pub fn admits(&self, cos: f32) -> Vec3 {
        (Vec3::ONE - self.albedo(cos)) / (Vec3::ONE - self.mean).max(Vec3::splat(1e-3))
    }

    /// The lobe (1/sr, without the cosine) for unit directions to the eye and to the light, and the density (1/sr) with
    /// which [`Coat::sample`] draws the latter. Nothing for a mirror, or from below.
    pub fn evaluate(&self, normal: Vec3, eye: Vec3, light: Vec3) -> (Vec3, f32) {
        let (seen, lit) = (normal.dot(eye), normal.dot(light));
        if self.is_smooth() || seen <= 0.0 || lit <= 0.0 {
            return (Vec3::ZERO, 0.0);
        }
        let half = (eye + light).normalize_or_zero();
        let along = eye.dot(half);
        let facets = self.facets(normal, half);
        let (a, b) = (hidden(seen, self.alpha), hidden(lit, self.alpha));
        let common = facets / (4.0 * seen);
        (self.fresnel(along) * (common / (lit * (1.0 + a + b))), common / (1.0 + a))
    }

    /// GGX's density of facets with normal `half`, 1/sr. By the sine: the cosine of a small angle has lost it.
    fn facets(&self, normal: Vec3, half: Vec3) -> f32 {
        let cos = normal.dot(half);
        if cos <= 0.0 {
            return 0.0;
        }
        let a2 = self.alpha * self.alpha;
        let sin2 = normal.cross(half).length_squared();
        let d = cos * cos * a2 + sin2;
        core::f32::consts::FRAC_1_PI * a2 / (d * d)
    }

    /// A direction for light that is seen from `eye`, from two uniform numbers; `None` where the facet that was drawn
    /// mirrors into the surface, and for a mirror.
    pub fn sample(&self, normal: Vec3, eye: Vec3, u1: f32, u2: f32) -> Option<Glossy> {
        let seen = normal.dot(eye);
        if self.is_smooth() || seen <= 0.0 {
            return None;
        }
        let shadow = eye - normal * seen;
        let length = shadow.length();
        let x = if length > 1e-6 { shadow / length } else { vector::frame(normal).0 };
        let y = normal.cross(x);
        let local = visible_normal(seen, self.alpha, u1, u2);
        let half = (x * local.x + y * local.y + normal * local.z).normalize();
        let along = eye.dot(half);
        let direction = (half * (2.0 * along) - eye).normalize();
        let lit = normal.dot(direction);
        // A direction in the surface itself would never leave it.
        if along <= 0.0 || lit <= 1e-4 {
            return None;
        }
        let (a, b) = (hidden(seen, self.alpha), hidden(lit, self.alpha));
        Some(Glossy {
            direction,
            weight: self.fresnel(along) * ((1.0 + a) / (1.0 + a + b)),
            density: self.facets(normal, half) / (4.0 * seen * (1.0 + a)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const N: Vec3 = Vec3::Z;

    fn eye(cos: f32) -> Vec3 {
        Vec3::new((1.0 - cos * cos).sqrt(), 0.0, cos)
    }

    /// The integral of `f` over the hemisphere of light directions; finest opposite to [`eye`], where lobes are narrow.
    fn integral(mut f: impl FnMut(Vec3) -> f64) -> f64 {
        let (rings, around) = (600, 300);
        let mut sum = 0.0;
        for i in 0..rings {
            // Uniform in the angle.
            let theta = (f64::from(i) + 0.5) / f64::from(rings) * core::f64::consts::FRAC_PI_2;
            for j in 0..around {
                let place = 2.0 * (f64::from(j) + 0.5) / f64::from(around) - 1.0;
                let phi = core::f64::consts::PI * (1.0 + place * place * place);
                let (s, c) = (libm::sin(theta), libm::cos(theta));
                let l =
                    Vec3::new((s * libm::cos(phi)) as f32, (s * libm::sin(phi)) as f32, c as f32);
                sum += s * 3.0 * place * place * f(l);
            }
        }
        sum * core::f64::consts::FRAC_PI_2 / f64::from(rings) * core::f64::consts::TAU
            / f64::from(around)
    }

    /// By quadrature over the hemisphere: the table is above the truth, by less than 0.01; gloss and white matter
    /// together reflect at most what arrives, and nearly that.
    #[test]
    fn albedos_by_quadrature() {
        for alpha in [0.07, 0.2, 0.45, 1.0] {
            for cos in [0.04, 0.3, 0.7, 1.0] {
                for f0 in [0.04, 0.5, 1.0] {
                    let coat = Coat::new(Vec3::splat(f0), alpha);
                    let gloss = integral(|l| f64::from(coat.evaluate(N, eye(cos), l).0.x * l.z));
                    let below = integral(|l| {
                        f64::from(coat.admits(l.z).x * l.z * core::f32::consts::FRAC_1_PI)
                    });
                    let table = f64::from(coat.albedo(cos).x);
                    let place =
                        format!("alpha {alpha}, cos {cos}, f0 {f0}: {gloss}, table {table}");
                    assert!(table >= gloss - 1e-4 && table < gloss + 0.01, "{place}");
                    // What reaches matter from all around is what it is to be, on average.
                    if f0 < 1.0 {
                        assert!((below - 1.0).abs() < 1e-3, "{place}: {below}");
                    }
                    let all = gloss + (1.0 - table) * below;
                    assert!(all <= 1.0 + 1e-4 && (f0 == 1.0 || all > 0.99), "{place}: {all}");
                }
            }
        }
    }

    /// Between the table's places, and where the lobe is narrow: by samples, which were held against quadrature above.
    #[test]
    fn tables_are_hardly_below_the_truth() {
        // Least and largest difference, within a degree of grazing and elsewhere.
        let mut worst = [[1.0f64, -1.0]; 2];
        for a in 0..67 {
            let root = SMOOTHEST.sqrt() + (1.0 - SMOOTHEST.sqrt()) * a as f32 / 66.0;
            for c in 1..59 {
                let cos = ((c as f32 + 0.37) / 59.0) * ((c as f32 + 0.37) / 59.0);
                let [grey, white] = albedo_by_sum(cos, root * root, [4181, 2584]);
                for f0 in [0.0, 0.04, 1.0] {
                    let truth = f64::from(f0) * grey + white;
                    let table = Coat::new(Vec3::splat(f0), root * root).albedo(cos).x;
                    let over = f64::from(table) - truth;
                    let worst = &mut worst[usize::from(cos > 0.02)];
                    *worst = [worst[0].min(over), worst[1].max(over)];
                }
            }
        }
        let [[low, high], [least, most]] = worst;
        assert!(low > -0.006 && high < 0.03 && least > -1e-3 && most < 0.012, "{worst:?}");
    }

    #[test]
    fn the_lobe_is_the_same_both_ways() {
        let coat = Coat::new(Vec3::new(0.9, 0.5, 0.04), 0.3);
        for i in 0..200 {
            let place = |k: u32| (i as f32 * 0.618_034 * k as f32).fract();
            let a = vector::cosine(N, place(1), place(2));
            let b = vector::cosine(N, place(3), place(5));
            let (there, back) = (coat.evaluate(N, a, b).0, coat.evaluate(N, b, a).0);
            assert!(
                (there - back).abs().max_element() <= 1e-4 * there.max_element(),
                "{there} {back}"
            );
        }
    }

    /// A sample's weight times its density is the lobe times the cosine; the density integrates to the share of facets
    /// that mirror upwards, and weights are at most Fresnel's reflectance.
    #[test]
    fn samples_agree_with_the_lobe() {
        let normal = Vec3::new(0.36, -0.48, 0.8);
        for alpha in [0.01, 0.1, 0.5, 1.0] {
            let coat = Coat::new(Vec3::new(1.0, 0.3, 0.04), alpha);
            for cos in [0.02, 0.4, 0.95, 1.0] {
                let (t, _) = vector::frame(normal);
                let eye = normal * cos + t * (1.0f32 - cos * cos).sqrt();
                let (n, mut up) = (64u32, 0u32);
                for i in 0..n * n {
                    let (u1, u2) = (((i / n) as f32 + 0.5) / 64.0, ((i % n) as f32 + 0.5) / 64.0);
                    let Some(s) = coat.sample(normal, eye, u1, u2) else { continue };
                    up += 1;
                    let (lobe, density) = coat.evaluate(normal, eye, s.direction);
                    let lit = s.direction.dot(normal);
                    assert!(s.weight.max_element() <= 1.0 + 1e-5);
                    // Narrow lobes at grazing angles: what rounding of a direction does to them.
                    if alpha >= 0.1 && lit > 0.01 {
                        let (a, b) = (lobe * lit, s.weight * s.density);
                        assert!((a - b).abs().max_element() < 0.02 * b.max_element(), "{a} {b}");
                        assert!((density - s.density).abs() < 0.02 * density, "{alpha} {cos}");
                    }
                }
                if alpha >= 0.1 {
                    let local = super::tests::eye(cos);
                    let whole = integral(|l| f64::from(coat.evaluate(N, local, l).1));
                    let share = f64::from(up) / f64::from(n * n);
                    assert!(
                        (whole - share).abs() < 0.01,
                        "alpha {alpha} cos {cos}: {whole} {share}"
                    );
                }
            }
        }
    }

    #[test]
    fn smooth_coats_are_mirrors_after_schlick() {
        let coat = Coat::new(Vec3::splat(0.04), 1e-4);
        assert!(coat.is_smooth());
        assert_eq!(coat.albedo(1.0), Vec3::splat(0.04));
        assert!((coat.albedo(0.0) - 1.0).abs().max_element() < 1e-6);
        assert!(coat.sample(N, N, 0.5, 0.5).is_none());
        assert_eq!(coat.evaluate(N, N, N), (Vec3::ZERO, 0.0));
        // The mean of 1 - E, by cosine, is 0.96 x 20/21.
        let mean = integral(|l| f64::from(coat.admits(l.z).x * l.z) / core::f64::consts::PI);
        assert!((mean - 1.0).abs() < 1e-4, "{mean}");
    }
}
