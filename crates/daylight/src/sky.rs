//! A sky with its absolute brightness, its sun and its ground.

use core::f64::consts::{PI, TAU};

use enf_layout::sky::SkyRecord;
use glam::DVec3;

use crate::SUN_RADIUS_DEGREES;
use crate::model::Pattern;

/// How bright, and of what colours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Amount {
    /// Diffuse irradiance on the horizontal, W/m2 (scalar).
    pub diffuse: f64,
    /// Direct irradiance square to the sun's rays, W/m2 (scalar).
    pub direct: f64,
    /// Reflectance of the ground beyond the scene, linear Rec.709.
    pub ground: [f64; 3],
    /// Colour of the sky; only its ratios count.
    pub color: [f64; 3],
    /// Colour of the sun; only its ratios count.
    pub sun_color: [f64; 3],
}

/// The record of a sky: `pattern` is scaled so that it gives the diffuse irradiance; the ground is lit by both. `sun` is
/// the unit vector to the sun, or zero.
pub fn record(pattern: &Pattern, sun: DVec3, amount: &Amount) -> SkyRecord {
    let unit = |color: [f64; 3]| {
        let of = 0.2126 * color[0] + 0.7152 * color[1] + 0.0722 * color[2];
        color.map(|c| c / of.max(f64::MIN_POSITIVE))
    };
    let (color, sun_color) = (unit(amount.color), unit(amount.sun_color));
    let mut record = SkyRecord {
        scale: 1.0,
        gradation: pattern.gradation,
        indicatrix: pattern.indicatrix,
        sun: sun.to_array(),
        sun_radius: SUN_RADIUS_DEGREES.to_radians(),
        sun_irradiance: sun_color.map(|c| c * amount.direct),
        color,
        ground: [0.0; 3],
    };
    let relative = Grid::new(&Sky::new(&record)).sky_irradiance(DVec3::Z);
    record.scale = if relative > 0.0 { amount.diffuse / relative } else { 0.0 };
    let level = sun.z.max(0.0);
    record.ground = core::array::from_fn(|i| {
        amount.ground[i] / PI * (color[i] * amount.diffuse + record.sun_irradiance[i] * level)
    });
    record
}

/// Answers what arrives from where.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sky {
    pattern: Pattern,
    scale: f64,
    sun: DVec3,
    sun_cos: f64,
    sun_irradiance: DVec3,
    color: DVec3,
    ground: DVec3,
}

impl Sky {
    /// Of a record.
    pub fn new(record: &SkyRecord) -> Self {
        Self {
            pattern: Pattern { gradation: record.gradation, indicatrix: record.indicatrix },
            scale: record.scale,
            sun: DVec3::from_array(record.sun),
            sun_cos: libm::cos(record.sun_radius),
            sun_irradiance: DVec3::from_array(record.sun_irradiance),
            color: DVec3::from_array(record.color),
            ground: DVec3::from_array(record.ground),
        }
    }

    /// Scalar radiance of the sky towards the unit vector `to`, W/m2/sr; 0 below the horizon.
    pub fn brightness(&self, to: DVec3) -> f64 {
        if to.z < 0.0 { 0.0 } else { self.scale * self.pattern.at(to.z, to.dot(self.sun)) }
    }

    /// Radiance of sky or ground towards the unit vector `to`, W/m2/sr, linear Rec.709, without the sun's disc.
    pub fn radiance(&self, to: DVec3) -> DVec3 {
        if to.z < 0.0 { self.ground } else { self.color * self.brightness(to) }
    }

    /// Radiance of the sun's disc towards `to`; zero beside it.
    pub fn sun_radiance(&self, to: DVec3) -> DVec3 {
        let inside = self.has_sun() && to.dot(self.sun) >= self.sun_cos;
        if inside { self.sun_irradiance / self.sun_solid_angle() } else { DVec3::ZERO }
    }

    /// Whether there is direct sunlight.
    pub fn has_sun(&self) -> bool {
        self.sun_irradiance.max_element() > 0.0
    }

    /// Solid angle of the sun's disc, sr.
    pub fn sun_solid_angle(&self) -> f64 {
        TAU * (1.0 - self.sun_cos)
    }

    /// Unit vector to the sun's centre, or zero.
    pub fn sun(&self) -> DVec3 {
        self.sun
    }

    /// Cosine of the sun's angular radius.
    pub fn sun_cos(&self) -> f64 {
        self.sun_cos
    }

    /// Irradiance by the sun square to its rays, W/m2.
    pub fn sun_irradiance(&self) -> DVec3 {
        self.sun_irradiance
    }

    /// Radiance of the ground, W/m2/sr.
    pub fn ground(&self) -> DVec3 {
        self.ground
    }

    /// Colour of the sky, of luminance 1.
    pub fn color(&self) -> DVec3 {
        self.color
    }
}

/// The sky on a grid of directions, for integrals: [`Grid::ROWS`] rings of equal solid angle from horizon to zenith, each of
/// [`Grid::COLUMNS`] cells.
#[derive(Clone, Debug)]
pub struct Grid {
    /// Scalar radiance in the middle of each cell, ring by ring.
    values: Vec<f32>,
    columns: Vec<(f64, f64)>,
    color: DVec3,
    ground: DVec3,
}

impl Grid {
    /// Rings.
    pub const ROWS: usize = 192;
    /// Cells of a ring.
    pub const COLUMNS: usize = 384;
    /// Heap bytes of a grid.
    pub const BYTES: u64 = (Self::ROWS * Self::COLUMNS * 4 + Self::COLUMNS * 16) as u64;

    /// Looks at the sky in the middle of each cell.
    pub fn new(sky: &Sky) -> Self {
        let columns: Vec<(f64, f64)> = (0..Self::COLUMNS)
            .map(|c| libm::sincos(TAU * (c as f64 + 0.5) / Self::COLUMNS as f64))
            .collect();
        let mut grid =
            Self { values: Vec::new(), columns, color: sky.color(), ground: sky.ground() };
        grid.values = (0..Self::ROWS * Self::COLUMNS)
            .map(|i| sky.brightness(grid.direction(i / Self::COLUMNS, i % Self::COLUMNS)) as f32)
            .collect();
        grid
    }

    /// Unit vector to the middle of a cell.
    pub fn direction(&self, row: usize, column: usize) -> DVec3 {
        let z = (row as f64 + 0.5) / Self::ROWS as f64;
        let level = libm::sqrt(1.0 - z * z);
        let (sin, cos) = self.columns[column];
        DVec3::new(cos * level, sin * level, z)
    }

    /// Scalar radiance in the middle of a cell, W/m2/sr.
    pub fn value(&self, row: usize, column: usize) -> f64 {
        f64::from(self.values[row * Self::COLUMNS + column])
    }

    /// Scalar irradiance by the sky alone on a surface that faces the unit vector `normal`, W/m2.
    pub fn sky_irradiance(&self, normal: DVec3) -> f64 {
        let mut sum = 0.0;
        for row in 0..Self::ROWS {
            let z = (row as f64 + 0.5) / Self::ROWS as f64;
            let level = libm::sqrt(1.0 - z * z);
            let mut ring = 0.0;
            for (column, &(sin, cos)) in self.columns.iter().enumerate() {
                let lift = (cos * normal.x + sin * normal.y) * level + z * normal.z;
                ring += self.value(row, column) * lift.max(0.0);
            }
            sum += ring;
        }
        sum * TAU / (Self::ROWS * Self::COLUMNS) as f64
    }

    /// Irradiance by sky and ground, without the sun, on a surface that faces `normal`, W/m2, linear Rec.709.
    pub fn irradiance(&self, normal: DVec3) -> DVec3 {
        // The part of the hemisphere below the horizon, weighted by the cosine: (1 - cos) / 2 of pi.
        let below = PI * (1.0 - normal.z.clamp(-1.0, 1.0)) / 2.0;
        self.color * self.sky_irradiance(normal) + self.ground * below
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Pattern;

    fn amount() -> Amount {
        Amount {
            diffuse: 100.0,
            direct: 500.0,
            ground: [0.2; 3],
            color: [1.0; 3],
            sun_color: [2.0; 3],
        }
    }

    /// A uniform sky of irradiance E has radiance E / pi; a wall gets half of it and half of the ground's.
    #[test]
    fn uniform_sky() {
        let sun = DVec3::new(0.6, 0.0, 0.8);
        let r = record(&Pattern::UNIFORM, sun, &amount());
        let sky = Sky::new(&r);
        let l = sky.radiance(DVec3::new(0.6, 0.0, 0.8));
        assert!((l - DVec3::splat(100.0 / PI)).abs().max_element() < 2e-3, "{l}");
        assert_eq!(r.sun_irradiance, [500.0; 3]);
        let ground = 0.2 / PI * (100.0 + 500.0 * 0.8);
        assert!((sky.radiance(DVec3::NEG_Z).x - ground).abs() < 1e-9);
        let wall = Grid::new(&sky).irradiance(DVec3::Y).x;
        assert!((wall - (50.0 + ground * PI / 2.0)).abs() < 5e-3, "{wall}");
    }

    /// The traditional overcast sky: zenith radiance 9 E / (7 pi); a wall has 0.396 of the horizontal irradiance.
    #[test]
    fn overcast_sky() {
        let r = record(&Pattern::cie(16), DVec3::ZERO, &Amount { ground: [0.0; 3], ..amount() });
        let sky = Sky::new(&r);
        assert!((sky.radiance(DVec3::Z).x - 900.0 / (7.0 * PI)).abs() < 0.01);
        // Integral of (1 + 2 z) cos over half of the hemisphere: pi/2 + 4/3, of 7 pi / 3.
        let share = (PI / 2.0 + 4.0 / 3.0) / (7.0 * PI / 3.0);
        let wall = Grid::new(&sky).irradiance(DVec3::X).x;
        assert!((wall / 100.0 - share).abs() < 1e-4, "{wall} {share}");
    }

    /// Every sky gives the irradiance that was asked for, by a quadrature of another kind.
    #[test]
    fn scaled_to_the_diffuse_irradiance() {
        let sun = DVec3::new(0.3, -0.4, 0.75f64.sqrt());
        for n in 1..=16 {
            let sky = Sky::new(&record(&Pattern::cie(n), sun, &amount()));
            let (rows, columns) = (400, 800);
            let mut sum = 0.0;
            for r in 0..rows {
                // Rings of equal cosine-weighted solid angle.
                let level = ((r as f64 + 0.5) / rows as f64).sqrt();
                let z = (1.0 - level * level).sqrt();
                for c in 0..columns {
                    let (sin, cos) = (TAU * (c as f64 + 0.5) / columns as f64).sin_cos();
                    sum += sky.brightness(DVec3::new(level * cos, level * sin, z));
                }
            }
            let found = sum * PI / (rows * columns) as f64;
            assert!((found - 100.0).abs() < 0.02, "sky {n}: {found}");
        }
    }

    /// The disc gives back the irradiance.
    #[test]
    fn sun_disc() {
        let sun = DVec3::new(0.6, 0.0, 0.8);
        let sky = Sky::new(&record(&Pattern::UNIFORM, sun, &amount()));
        let l = sky.sun_radiance(sun).x;
        assert!((l * sky.sun_solid_angle() - 500.0).abs() < 1e-9);
        assert!((sky.sun_solid_angle() - 6.797e-5).abs() < 1e-7);
        let beside = DVec3::new(0.6, 0.0047, 0.8).normalize();
        assert_eq!(sky.sun_radiance(beside), DVec3::ZERO);
        assert!(sky.sun_radiance(DVec3::new(0.6, 0.0046, 0.8).normalize()).x > 0.0);
    }
}
