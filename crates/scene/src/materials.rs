//! From what MTL and scene files say to what photons see.
//!
//! | says | becomes |
//! |---|---|
//! | `Kd` | `diffuse`; 0.8 where missing (0 for a mirror) |
//! | `Ke` | `emission`, W/m²/sr, from the counter-clockwise side |
//! | `Pr`, else `Ns` | roughness: GGX alpha = `Pr`², or (2 / (`Ns` + 2))^1/2 |
//! | `illum` 3, 5, 8, 9 with `Ks` | `specular = Ks`: a gloss of that roughness; a mirror without, or if it is below 0.002 |
//! | `Pm` >= 0.9, no roughness | a mirror: `specular = Ks` and `diffuse = (1 - Pm) Kd`; without `Ks`: `specular = Kd`, `diffuse = 0` |
//! | `Pm` with a roughness | a gloss: `specular = Ks`, without `Ks` from 0.04 to `Kd` by `Pm`; `diffuse = (1 - Pm) Kd` |
//! | other `Ks` with a roughness | a gloss of reflectance `specular = Ks` on `diffuse = Kd`; not with `illum` 0 or 1 |
//! | `Pr` alone | a gloss of reflectance ((`Ni` - 1) / (`Ni` + 1))², without `Ni` 0.04, on `Kd` |
//! | `Ks` without a roughness | a highlight of no known width: left out, with one warning for all |
//! | `d` < 1, `Tr` > 0, some 0 < `Tf` < 1, `illum` 4, 6, 7, 9 | a thin pane: `transmission = Tf` (without: `1 - d`), `diffuse = d Kd`, `index = Ni` (without: 1.5), see-through |
//! | `illum` 4, `Tf 1 1 1`, `Ni` <= 1, no `d` < 1 | opaque: Maya writes that for every Lambert surface |
//! | `d 1`, no `Tf` | opaque, whatever `illum` says |
//! | `solid` (scene file) | solid glass: `transmission = Tf` (without: 1) at each crossing, `index = Ni` (without: 1.5), `absorption` |
//! | `map_Kd` | a texture that `diffuse` is multiplied by; `Kd` is then 1 where it is missing or black |
//! | other `map_...` | left out, with one warning for all |
//!
//! A pane without `d` (`illum` 4, 6, 7, 9) has no diffuse part. Channels whose parts sum to more than 1
//! are scaled down, with a warning; matter below a gloss gets what the gloss leaves, so there each part counts alone.

use crate::mtl::Spec;
use enf_layout::material::{
    MATERIAL_GLOSS, MATERIAL_ONE_SIDED_EMITTER, MATERIAL_SEE_THROUGH, MATERIAL_SOLID,
    MaterialRecord, SMOOTHEST_GLOSS,
};

/// Reflectance of what has no material.
pub(crate) const DEFAULT_GREY: f64 = 0.7;
/// `Kd` of a material that says nothing (the MTL specification's default).
const DEFAULT_KD: f64 = 0.8;
/// `Ni` of a pane that says nothing: window glass.
const DEFAULT_NI: f64 = 1.5;
/// Reflectance at normal incidence of what is neither metal nor says more: index 1.5.
pub(crate) const DEFAULT_F0: f64 = 0.04;
/// Highlights below this are none: CAD exporters write `Ks` 0.0039 (1/255) for that.
const LEAST_KS: f64 = 0.004;

/// A mapped material and what was lost on the way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Mapped {
    pub(crate) record: MaterialRecord,
    /// A highlight was left out.
    pub(crate) highlight: bool,
    /// Reflectances were out of range and scaled or clamped.
    pub(crate) scaled: bool,
}

/// Reflectance at normal incidence of a smooth surface of this refractive index.
pub(crate) fn f0_of(index: f64) -> f64 {
    let root = (index.clamp(1.0, 10.0) - 1.0) / (index.clamp(1.0, 10.0) + 1.0);
    root * root
}

/// What an opaque surface reflects.
struct Opaque {
    diffuse: [f64; 3],
    specular: [f64; 3],
    /// GGX alpha of a gloss; `None`: `specular` is a mirror's.
    gloss: Option<f64>,
    highlight: bool,
}

/// An opaque surface; see the table above.
fn opaque(spec: &Spec) -> Opaque {
    let ks = spec.ks.unwrap_or([0.0; 3]);
    let any = |c: [f64; 3]| c.iter().any(|&v| v > 0.0);
    let kd = |missing: f64| spec.kd.unwrap_or([missing; 3]);
    // GGX alpha; Walter et al. 2007, section 5.2, for Phong's exponent.
    let alpha = match (spec.pr, spec.ns) {
        (Some(pr), _) => {
            let root = pr.clamp(0.0, 1.0);
            Some(root * root)
        }
        (None, Some(ns)) => Some((2.0 / (ns.max(0.0) + 2.0)).sqrt()),
        (None, None) => None,
    };
    let rough = alpha.filter(|&a| a >= f64::from(SMOOTHEST_GLOSS));
    let lacks_width = ks.iter().any(|&v| v > LEAST_KS);
    let plain = |specular, diffuse, gloss| Opaque { diffuse, specular, gloss, highlight: false };
    if let Some(mirror) = spec.mirror {
        let gloss = rough.filter(|_| spec.pr.is_some() && any(mirror));
        return plain(mirror, kd(if any(mirror) { 0.0 } else { DEFAULT_KD }), gloss);
    }
    if matches!(spec.illum, Some(3 | 5 | 8 | 9)) && any(ks) {
        return plain(ks, kd(0.0), rough);
    }
    if let Some(pm) = spec.pm.map(|pm| pm.clamp(0.0, 1.0)) {
        if alpha.is_some() {
            let base = kd(DEFAULT_KD);
            let mixed = base.map(|v| DEFAULT_F0 + pm * (v - DEFAULT_F0));
            let specular = if any(ks) { ks } else { mixed };
            return plain(specular, base.map(|v| v * (1.0 - pm)), alpha);
        }
        if pm >= 0.9 {
            return if any(ks) {
                plain(ks, kd(0.0).map(|v| v * (1.0 - pm)), None)
            } else {
                plain(kd(DEFAULT_KD), [0.0; 3], None)
            };
        }
    }
    let matt = !matches!(spec.illum, Some(0 | 1)) || spec.pr.is_some();
    match (spec.ks, alpha.filter(|_| matt)) {
        (Some(_), Some(_)) if lacks_width => plain(ks, kd(DEFAULT_KD), alpha),
        (None, Some(_)) if spec.pr.is_some() => {
            let f0 = spec.ni.filter(|&n| n > 1.0).map_or(DEFAULT_F0, f0_of);
            plain([f0; 3], kd(DEFAULT_KD), alpha)
        }
        _ => Opaque { highlight: lacks_width, ..plain([0.0; 3], kd(DEFAULT_KD), None) },
    }
}

/// Maps a material; see the table above. Its texture's number is left to the caller.
pub(crate) fn map(spec: &Spec) -> Mapped {
    if spec.map_kd.is_some() && spec.kd.is_none_or(|kd| kd == [0.0; 3]) {
        // Exporters write black, or nothing, and mean the picture.
        return map(&Spec { map_kd: None, kd: Some([1.0; 3]), ..spec.clone() });
    }
    let d = spec.d.map(|d| d.clamp(0.0, 1.0));
    let any = |c: [f64; 3]| c.iter().any(|&v| v > 0.0);

    let forced_opaque = spec.glass == Some(false) || spec.mirror.is_some_and(any);
    let said_opaque = d == Some(1.0) && spec.tf.is_none();
    let maya_opaque = spec.illum == Some(4)
        && d.is_none_or(|d| d == 1.0)
        && spec.tf == Some([1.0; 3])
        && spec.ni.is_none_or(|n| n <= 1.0);
    let glass = spec.glass == Some(true);
    let clear =
        glass || (matches!(spec.illum, Some(4 | 6 | 7 | 9)) && !said_opaque && !maya_opaque);
    let tinted = spec.tf.is_some_and(|t| any(t) && t.iter().any(|&v| v < 1.0));
    let pane = !forced_opaque && (clear || tinted || d.is_some_and(|d| d < 1.0));
    let coverage = match d {
        Some(d) if d < 1.0 => d,
        _ if clear => 0.0,
        _ => 1.0,
    };
    let transmission = if spec.solid {
        spec.tf.unwrap_or([1.0; 3])
    } else if pane {
        spec.tf.unwrap_or([1.0 - coverage; 3])
    } else {
        [0.0; 3]
    };
    let pane = !spec.solid && pane && any(transmission);

    let Opaque { mut diffuse, mut specular, gloss, highlight } = if spec.solid {
        Opaque { diffuse: [0.0; 3], specular: [0.0; 3], gloss: None, highlight: false }
    } else if pane {
        let scale = if spec.kd_final { 1.0 } else { coverage };
        let diffuse = spec.kd.unwrap_or([DEFAULT_KD; 3]).map(|v| v * scale);
        Opaque { diffuse, specular: [0.0; 3], gloss: None, highlight: false }
    } else {
        opaque(spec)
    };

    let mut scaled = false;
    let mut transmission = transmission;
    let mut record = MaterialRecord {
        emission: spec.ke.unwrap_or([0.0; 3]).map(|v| v.max(0.0) as f32),
        ..MaterialRecord::BLACK
    };
    if pane || spec.solid {
        record.index = spec.ni.unwrap_or(DEFAULT_NI).clamp(1.0, 10.0) as f32;
        record.flags |= MATERIAL_SEE_THROUGH;
    }
    if spec.solid {
        record.absorption = spec.absorption.unwrap_or([0.0; 3]).map(|v| v.max(0.0) as f32);
        record.flags |= MATERIAL_SOLID;
    }
    if let Some(alpha) = gloss {
        record.roughness = alpha.clamp(0.0, 1.0) as f32;
        record.flags |= MATERIAL_GLOSS;
    }
    if record.emission.iter().any(|&v| v > 0.0) || spec.power.is_some() {
        record.flags |= MATERIAL_ONE_SIDED_EMITTER;
    }
    for c in 0..3 {
        for part in [&mut diffuse[c], &mut specular[c], &mut transmission[c]] {
            scaled |= *part < 0.0;
            *part = part.max(0.0);
        }
        if gloss.is_some() {
            scaled |= diffuse[c].max(specular[c]) > 1.0 + 1e-6;
            record.diffuse[c] = diffuse[c].min(1.0) as f32;
            record.specular[c] = specular[c].min(1.0) as f32;
            continue;
        }
        let sum = diffuse[c] + specular[c] + transmission[c];
        scaled |= sum > 1.0 + 1e-6;
        let scale = if sum > 1.0 { 1.0 / sum } else { 1.0 };
        let mut parts = [diffuse[c], specular[c], transmission[c]].map(|v| (v * scale) as f32);
        // Rounding must not create light either.
        while parts.iter().map(|&v| f64::from(v)).sum::<f64>() > 1.0 {
            for v in &mut parts {
                *v = if *v > 0.0 { v.next_down() } else { *v };
            }
        }
        [record.diffuse[c], record.specular[c], record.transmission[c]] = parts;
    }
    Mapped { record, highlight, scaled }
}

/// The grey of what has no material.
pub(crate) fn default_spec() -> Spec {
    Spec { kd: Some([DEFAULT_GREY; 3]), ..Spec::default() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn spec(text: &str) -> Spec {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("m.mtl");
        std::fs::write(&path, format!("newmtl m\n{}\n", text.replace("; ", "\n"))).unwrap();
        crate::mtl::read(&path).unwrap().0.remove("m").unwrap()
    }

    /// diffuse, specular, transmission (first channel), index.
    fn mapped(text: &str) -> [f32; 4] {
        let r = map(&spec(text)).record;
        [r.diffuse[0], r.specular[0], r.transmission[0], r.index]
    }

    #[test]
    fn the_table_row_by_row() {
        assert_eq!(mapped(""), [0.8, 0.0, 0.0, 1.0]);
        assert_eq!(mapped("Kd 0.5 0.6 0.7"), [0.5, 0.0, 0.0, 1.0]);
        assert_eq!(mapped("Kd 0.25"), [0.25, 0.0, 0.0, 1.0]);
        assert_eq!(mapped("Kd 0.5 0.5 0.5; Ks 0.3 0.3 0.3; illum 2"), [0.5, 0.0, 0.0, 1.0]);
        assert_eq!(mapped("Kd 0.5 0.5 0.5; Ks 0.3 0.3 0.3; Ns 9; illum 1"), [0.5, 0.0, 0.0, 1.0]);
        assert_eq!(mapped("Kd 0.5 0.5 0.5; Ks 0.0039; Ns 9; illum 2"), [0.5, 0.0, 0.0, 1.0]);
        for illum in [3, 5, 8] {
            let text = format!("Kd 0.1 0.1 0.1; Ks 0.75 0.75 0.75; illum {illum}");
            assert_eq!(mapped(&text), [0.1, 0.75, 0.0, 1.0], "{illum}");
        }
        assert_eq!(mapped("Kd 0 0 0; Ks 1 1 1; illum 9; d 0"), [0.0, 0.0, 1.0, 1.5]);
        assert_eq!(mapped("Ks 0.5 0.5 0.5; illum 3"), [0.0, 0.5, 0.0, 1.0]);
        assert_eq!(mapped("Kd 0.5 0.5 0.5; Pm 1"), [0.0, 0.5, 0.0, 1.0]);
        assert_eq!(mapped("Kd 0.5 0.5 0.5; Ks 0.25 0.25 0.25; Pm 1"), [0.0, 0.25, 0.0, 1.0]);
        // Panes.
        assert_eq!(mapped("Kd 0.5 0.5 0.5; d 0.25"), [0.125, 0.0, 0.75, 1.5]);
        assert_eq!(mapped("Kd 0.5 0.5 0.5; Tr 0.75; Ni 1.25"), [0.125, 0.0, 0.75, 1.25]);
        assert_eq!(mapped("Kd 0.5 0.5 0.5; Tr 0.5; d 1"), [0.5, 0.0, 0.0, 1.0]);
        assert_eq!(mapped("Kd 0.1 0.1 0.1; Tf 0.5 0.5 0.5"), [0.1, 0.0, 0.5, 1.5]);
        assert_eq!(mapped("Kd 0.5 0.5 0.5; d 0; Tf 0.9 0.9 0.9; illum 7"), [0.0, 0.0, 0.9, 1.5]);
        for illum in [4, 6, 7, 9] {
            assert_eq!(mapped(&format!("Kd 0.5 0.5 0.5; illum {illum}")), [0.0, 0.0, 1.0, 1.5]);
        }
        // What exporters write for opaque matter.
        assert_eq!(
            mapped("illum 4; Kd 0.5 0.5 0.5; Tf 1.00 1.00 1.00; Ni 1.00"),
            [0.5, 0.0, 0.0, 1.0]
        );
        assert_eq!(mapped("Kd 0.5 0.5 0.5; d 1; Tr 0; Tf 1 1 1; illum 2"), [0.5, 0.0, 0.0, 1.0]);
        assert_eq!(mapped("Kd 0.5 0.5 0.5; Tf 0 0 0"), [0.5, 0.0, 0.0, 1.0]);
        assert_eq!(mapped("Kd 0.5 0.5 0.5; d 1; illum 7"), [0.5, 0.0, 0.0, 1.0]);
    }

    /// diffuse, specular (first channel), alpha; `None` without gloss.
    fn gloss(text: &str) -> Option<[f32; 3]> {
        let r = map(&spec(text)).record;
        assert!(!map(&spec(text)).highlight, "{text}");
        (r.flags & MATERIAL_GLOSS != 0).then_some([r.diffuse[0], r.specular[0], r.roughness])
    }

    #[test]
    fn gloss_row_by_row() {
        assert_eq!(gloss("Kd 0.8; Ks 0.5; Ns 6; illum 2"), Some([0.8, 0.5, 0.5]));
        assert_eq!(gloss("Kd 0.8; Ks 0.5; Ns 30"), Some([0.8, 0.5, 0.25]));
        assert_eq!(gloss("Kd 0.8; Ks 0.5; Pr 0.5; Ns 30"), Some([0.8, 0.5, 0.25]));
        assert_eq!(gloss("Kd 0.8; Pr 0.5"), Some([0.8, 0.04, 0.25]));
        assert_eq!(gloss("Kd 0.8; Pr 0.5; Ni 3"), Some([0.8, 0.25, 0.25]));
        assert_eq!(gloss("Kd 0.8; Pr 0.5; Ks 0"), None);
        assert_eq!(gloss("Kd 0.5; Pm 1; Pr 0.5"), Some([0.0, 0.5, 0.25]));
        assert_eq!(gloss("Kd 0.54; Pm 0.5; Pr 0.5"), Some([0.27, 0.29, 0.25]));
        assert_eq!(gloss("Kd 0.1; Ks 0.7; Ns 30; illum 3"), Some([0.1, 0.7, 0.25]));
        // As smooth as this: a mirror.
        assert_eq!(gloss("Kd 0.1; Ks 0.7; Ns 1e6; illum 3"), None);
        assert_eq!(mapped("Kd 0.1; Ks 0.7; Ns 1e6; illum 3"), [0.1, 0.7, 0.0, 1.0]);
        // Below a gloss, matter gets what is left.
        assert!(!map(&spec("Kd 0.8; Ks 0.5; Ns 30")).scaled);
        assert!(map(&spec("Kd 0.8; Ks 1.5; Ns 30")).scaled);
    }

    #[test]
    fn solid_glass() {
        let said = Spec {
            solid: true,
            kd: Some([0.5; 3]),
            ni: Some(1.52),
            absorption: Some([7.0, 1.0, 0.0]),
            ..Spec::default()
        };
        let r = map(&said).record;
        assert_eq!(r.flags, MATERIAL_SOLID | MATERIAL_SEE_THROUGH);
        assert_eq!((r.diffuse, r.transmission, r.index), ([0.0; 3], [1.0; 3], 1.52));
        assert_eq!(r.absorption, [7.0, 1.0, 0.0]);
    }

    #[test]
    fn emission_and_flags() {
        let m = map(&spec("Kd 0 0 0; Ke 17 12 4"));
        assert_eq!(m.record.emission, [17.0, 12.0, 4.0]);
        assert_eq!(m.record.flags, MATERIAL_ONE_SIDED_EMITTER);
        assert_eq!(map(&spec("d 0.1")).record.flags, MATERIAL_SEE_THROUGH);
        assert_eq!(map(&spec("Kd 1 1 1")).record.flags, 0);
        assert!(map(&spec("Ks 0.5 0.5 0.5")).highlight);
        assert!(!map(&spec("Ks 0.0039 0.0039 0.0039")).highlight);
    }

    #[test]
    fn light_is_never_created() {
        let m = map(&spec("Kd 0.8 0.8 0.4; Ks 0.8 0.2 0.1; illum 3"));
        assert!(m.scaled);
        assert_eq!(m.record.diffuse[0], 0.5);
        assert_eq!(m.record.specular[0], 0.5);
        assert_eq!(m.record.diffuse[2], 0.4);
        let m = map(&spec("Kd -1 255 0.5"));
        assert!(m.scaled);
        assert_eq!(m.record.diffuse, [0.0, 1.0, 0.5]);
        assert!(!map(&spec("Kd 0.6 0.6 0.6; Ks 0.4 0.4 0.4; illum 3")).scaled);
    }

    proptest! {
        #[test]
        fn any_numbers_give_a_material_that_conserves(
            kd in proptest::option::of(proptest::array::uniform3(-1e30..1e30f64)),
            ks in proptest::option::of(proptest::array::uniform3(-0.5..2.0f64)),
            tf in proptest::option::of(proptest::array::uniform3(-0.5..2.0f64)),
            d in proptest::option::of(-1.0..2.0f64),
            ni in proptest::option::of(-1e30..1e30f64),
            pm in proptest::option::of(-1.0..2.0f64),
            illum in proptest::option::of(0..12u8),
            glass in proptest::option::of(any::<bool>()),
            ns in proptest::option::of(-1e30..1e30f64),
            solid in any::<bool>(),
        ) {
            let said = Spec { kd, ks, tf, d, ni, pm, ns, illum, glass, solid, ..Spec::default() };
            let r = map(&said).record;
            prop_assert!((0.0..=1.0).contains(&r.roughness));
            for c in 0..3 {
                if r.flags & MATERIAL_GLOSS != 0 {
                    prop_assert!((0.0..=1.0).contains(&r.diffuse[c]));
                    prop_assert!((0.0..=1.0).contains(&r.specular[c]));
                    continue;
                }
                let parts = [r.diffuse[c], r.specular[c], r.transmission[c]];
                prop_assert!(parts.iter().all(|&v| v >= 0.0));
                prop_assert!(parts.iter().map(|&v| f64::from(v)).sum::<f64>() <= 1.0);
            }
            prop_assert!(r.index >= 1.0 && r.index.is_finite());
            let clear = r.transmission != [0.0; 3] || solid;
            prop_assert_eq!(clear, r.flags & MATERIAL_SEE_THROUGH != 0);
        }
    }
}
