//! From what MTL and scene files say to what photons see.
//!
//! | says | becomes |
//! |---|---|
//! | `Kd` | `diffuse`; 0.8 where missing (0 for a mirror) |
//! | `Ke` | `emission`, W/m²/sr, from the counter-clockwise side |
//! | `illum` 3, 5, 8, 9 | `specular = Ks`: a mirror |
//! | `Pm` >= 0.9 | `specular = Ks` and `diffuse = (1 - Pm) Kd`; without `Ks`: `specular = Kd`, `diffuse = 0` |
//! | other `Ks` | a highlight: left out, with one warning for all |
//! | `d` < 1, `Tr` > 0, some 0 < `Tf` < 1, `illum` 4, 6, 7, 9 | a thin pane: `transmission = Tf` (without: `1 - d`), `diffuse = d Kd`, `index = Ni` (without: 1.5), see-through |
//! | `illum` 4, `Tf 1 1 1`, `Ni` <= 1, no `d` < 1 | opaque: Maya writes that for every Lambert surface |
//! | `d 1`, no `Tf` | opaque, whatever `illum` says |
//! | `map_...` | left out, with one warning for all |
//!
//! A pane without `d` (`illum` 4, 6, 7, 9) has no diffuse part. Channels whose parts sum to more than 1
//! are scaled down, with a warning.

use crate::mtl::Spec;
use enf_layout::material::{MATERIAL_ONE_SIDED_EMITTER, MATERIAL_SEE_THROUGH, MaterialRecord};

/// Reflectance of what has no material.
pub(crate) const DEFAULT_GREY: f64 = 0.7;
/// `Kd` of a material that says nothing (the MTL specification's default).
const DEFAULT_KD: f64 = 0.8;
/// `Ni` of a pane that says nothing: window glass.
const DEFAULT_NI: f64 = 1.5;

/// A mapped material and what was lost on the way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Mapped {
    pub(crate) record: MaterialRecord,
    /// A highlight was left out.
    pub(crate) highlight: bool,
    /// Reflectances were out of range and scaled or clamped.
    pub(crate) scaled: bool,
}

/// Maps a material; see the table above.
pub(crate) fn map(spec: &Spec) -> Mapped {
    let d = spec.d.map(|d| d.clamp(0.0, 1.0));
    let ks = spec.ks.unwrap_or([0.0; 3]);
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
    let transmission = if pane { spec.tf.unwrap_or([1.0 - coverage; 3]) } else { [0.0; 3] };
    let pane = pane && any(transmission);

    let (mut diffuse, mut specular, mut highlight);
    let kd = |missing: f64| spec.kd.unwrap_or([missing; 3]);
    if pane {
        let scale = if spec.kd_final { 1.0 } else { coverage };
        diffuse = kd(DEFAULT_KD).map(|v| v * scale);
        specular = [0.0; 3];
        highlight = false;
    } else if let Some(mirror) = spec.mirror {
        specular = mirror;
        diffuse = kd(if any(mirror) { 0.0 } else { DEFAULT_KD });
        highlight = false;
    } else if matches!(spec.illum, Some(3 | 5 | 8 | 9)) && any(ks) {
        specular = ks;
        diffuse = kd(0.0);
        highlight = false;
    } else if let Some(pm) = spec.pm.filter(|&pm| pm >= 0.9) {
        if any(ks) {
            specular = ks;
            diffuse = kd(0.0).map(|v| v * (1.0 - pm.min(1.0)));
        } else {
            specular = kd(DEFAULT_KD);
            diffuse = [0.0; 3];
        }
        highlight = false;
    } else {
        diffuse = kd(DEFAULT_KD);
        specular = [0.0; 3];
        highlight = any(ks);
    }
    // CAD exporters write Ks 0.0039 (1/255) for "none".
    highlight &= ks.iter().any(|&v| v > 0.004);

    let mut scaled = false;
    let mut transmission = transmission;
    let mut record = MaterialRecord {
        diffuse: [0.0; 3],
        specular: [0.0; 3],
        transmission: [0.0; 3],
        emission: spec.ke.unwrap_or([0.0; 3]).map(|v| v.max(0.0) as f32),
        index: if pane { spec.ni.unwrap_or(DEFAULT_NI).clamp(1.0, 10.0) as f32 } else { 1.0 },
        flags: if pane { MATERIAL_SEE_THROUGH } else { 0 },
        reserved: [0; 2],
    };
    if record.emission.iter().any(|&v| v > 0.0) || spec.power.is_some() {
        record.flags |= MATERIAL_ONE_SIDED_EMITTER;
    }
    for c in 0..3 {
        for part in [&mut diffuse[c], &mut specular[c], &mut transmission[c]] {
            scaled |= *part < 0.0;
            *part = part.max(0.0);
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
        ) {
            let r = map(&Spec { kd, ks, tf, d, ni, pm, illum, glass, ..Spec::default() }).record;
            for c in 0..3 {
                let parts = [r.diffuse[c], r.specular[c], r.transmission[c]];
                prop_assert!(parts.iter().all(|&v| v >= 0.0));
                prop_assert!(parts.iter().map(|&v| f64::from(v)).sum::<f64>() <= 1.0);
            }
            prop_assert!(r.index >= 1.0 && r.index.is_finite());
            prop_assert_eq!(r.transmission != [0.0; 3], r.flags & MATERIAL_SEE_THROUGH != 0);
        }
    }
}
