//! A scene for Radiance (Ward 1994): `scene.rad` with materials, polygons and lights, and `VIEW.vf` for each view.
//!
//! ```text
//! oconv scene.rad > scene.oct
//! rpict -vf VIEW.vf -x 480 -y 360 -pj 0 scene.oct > VIEW.hdr
//! ```
//!
//! | here | there |
//! |---|---|
//! | Lambert, and a mirror on it | `plastic`, whose mirror is white; `metal` where there is nothing but mirror |
//! | gloss | the same with a roughness: a Gaussian lobe (Ward-Duer) instead of GGX |
//! | see-through sheet | `glass` of the same transmittance straight on; a pure tint: `trans` |
//! | solid glass | `dielectric`, with its absorption |
//! | area lights | `light`, one-sided, which reflects nothing |
//! | points, Lambertian points | a sphere, a ring of 5 mm |
//! | spots | `spotlight`, with a hard edge |

use std::fmt::Write as _;
use std::path::Path;

use enf_layout::NONE;
use enf_layout::light::{LIGHT_AREA, LIGHT_POINT, LIGHT_POINT_LAMBERT, LIGHT_SPOT};
use enf_layout::material::{MATERIAL_GLOSS, MATERIAL_SOLID, MaterialRecord, SMOOTHEST_GLOSS};
use enf_scene::View;
use enf_stage::Result;
use enf_stage::failure::IoContext;
use glam::Vec3;

use crate::Notes;
use crate::building::{Building, Light};
use crate::view::{Shown, shown};

/// Radius of what a point becomes, m.
const POINT_M: f64 = 5e-3;

/// Writes `scene.rad` and the views' files into a folder that is made if it is not there. Returns what has no faithful
/// counterpart.
///
/// # Errors
/// Exit 5 when a file cannot be written.
pub fn write(building: &Building, views: &[View], folder: &Path) -> Result<Notes> {
    std::fs::create_dir_all(folder).at("create", folder)?;
    let mut notes = Notes::default();
    let path = folder.join("scene.rad");
    std::fs::write(&path, scene(building, &mut notes)).at("write", &path)?;
    for view in views {
        match shown(view) {
            Ok(shown) => {
                let path = folder.join(format!("{}.vf", view.name));
                std::fs::write(&path, camera(view, shown)).at("write", &path)?;
            }
            Err(why) => notes.view(&view.name, why),
        }
    }
    Ok(notes)
}

fn scene(building: &Building, notes: &mut Notes) -> String {
    let mut text = String::new();
    let groups = building.groups();
    let mut defined: Vec<u32> = groups.iter().map(|(key, _)| key.0).collect();
    defined.dedup();
    for material in defined {
        let (name, record) = &building.materials[material as usize];
        let mut diffuse = record.diffuse;
        if let Some(picture) = building.pictures.get(record.texture as usize) {
            diffuse = [0, 1, 2].map(|c| diffuse[c] * picture.mean[c]);
            notes.material(name, "its texture became its mean");
        }
        let mut said = Vec::new();
        let _ =
            writeln!(text, "# {}", name.chars().filter(|c| !c.is_control()).collect::<String>());
        text += &matter(material, record, diffuse, &mut said);
        if record.emission != [0.0; 3] {
            let [r, g, b] = record.emission;
            let _ = writeln!(text, "void light e{material}\n0\n0\n3 {r} {g} {b}");
            if diffuse != [0.0; 3] || record.specular != [0.0; 3] {
                said.push("where it emits it does not reflect");
            }
        }
        said.into_iter().for_each(|what| notes.material(name, what));
    }
    for ((material, light, _), triangles) in &groups {
        let kind = if *light == NONE { 'm' } else { 'e' };
        for triangle in triangles {
            let _ = write!(text, "{kind}{material} polygon t{}\n0\n0\n9", triangle.index);
            for [x, y, z] in triangle.corners {
                let _ = write!(text, " {x} {y} {z}");
            }
            text.push('\n');
        }
    }
    for (index, light) in building.lights.iter().enumerate() {
        text += &source(index, light, notes);
    }
    if building.daylight {
        notes.light("sky", "left out: write one with gensky or gendaylit");
    }
    text
}

/// A material as primitives of the name `mID`.
fn matter(
    id: u32,
    record: &MaterialRecord,
    diffuse: [f32; 3],
    said: &mut Vec<&'static str>,
) -> String {
    let largest = |c: [f32; 3]| c.into_iter().fold(0.0, f32::max);
    let [r, g, b] = diffuse;
    let (specular, transmission) = (record.specular, record.transmission);
    if record.flags & MATERIAL_SOLID != 0 {
        if largest(transmission.map(|t| 1.0 - t)) > 0.0 {
            said.push("the tint of each crossing is lost");
        }
        let [r, g, b] = record.absorption.map(|a| libm::expf(-a.max(0.0)));
        return format!("void dielectric m{id}\n0\n0\n5 {r} {g} {b} {} 0\n", record.index);
    }
    if largest(transmission) > 0.0 {
        if largest(diffuse) > 0.0 {
            said.push("the diffuse part of a pane is lost");
        }
        if record.index <= 1.0 {
            let [r, g, b] = transmission;
            return format!("void trans m{id}\n0\n0\n7 {r} {g} {b} 0 0 1 1\n");
        }
        said.push("a sheet of one interface became a pane of the same transmittance straight on; it mirrors twice as much");
        // Two faces with transmissivity t: T = (1-R)^2 t / (1 - R^2 t^2) is to be (1-R) times ours.
        let root = (record.index - 1.0) / (record.index + 1.0);
        let rho = root * root;
        let [r, g, b] = transmission.map(|t| {
            let (a, whole) = ((1.0 - rho) * (1.0 - rho), (1.0 - rho) * t);
            if whole <= 0.0 {
                return 0.0;
            }
            // whole rho^2 t^2 + a t - whole = 0
            let root = (a * a + 4.0 * whole * whole * rho * rho).sqrt();
            2.0 * whole / (a + root)
        });
        return format!("void glass m{id}\n0\n0\n4 {r} {g} {b} {}\n", record.index);
    }
    let is_gloss = record.flags & MATERIAL_GLOSS != 0;
    let rough = is_gloss && record.roughness >= SMOOTHEST_GLOSS;
    if rough {
        said.push("its gloss is Gaussian, of the same root of the mean square slope near its top, without Fresnel's rise of facets");
    }
    // Ward's alpha is the root of the mean square slope; GGX's peak is that of a Gaussian of the same alpha.
    let alpha = if rough { record.roughness } else { 0.0 };
    if largest(specular) <= 0.0 {
        return format!("void plastic m{id}\n0\n0\n5 {r} {g} {b} 0 0\n");
    }
    if largest(diffuse) <= 0.0 {
        let [r, g, b] = specular;
        return format!("void metal m{id}\n0\n0\n5 {r} {g} {b} 1 {alpha}\n");
    }
    let mean = enf_image::luminance(specular).min(0.999);
    if largest(specular.map(|v| (v - mean).abs())) > 1e-3 {
        said.push("the colour of what it mirrors is lost");
    }
    // Below a gloss matter gets what the gloss leaves, as in plastic; beside a mirror it has its own share.
    let scale = if is_gloss { 1.0 } else { 1.0 / (1.0 - mean) };
    let [r, g, b] = diffuse.map(|v| (v * scale).min(1.0));
    format!("void plastic m{id}\n0\n0\n5 {r} {g} {b} {mean} {alpha}\n")
}

/// A point light.
fn source(index: usize, light: &Light, notes: &mut Notes) -> String {
    let record = &light.record;
    let disc = core::f64::consts::PI * POINT_M * POINT_M;
    let radiance = |steradians: f64| {
        let [r, g, b] = record.flux_w.map(|f| f64::from(f) / (steradians * disc));
        format!("{r} {g} {b}")
    };
    let [x, y, z] = record.position;
    let [ax, ay, az] = record.axis;
    match record.kind {
        LIGHT_AREA => String::new(),
        LIGHT_POINT => format!(
            "void light l{index}\n0\n0\n3 {}\nl{index} sphere p{index}\n0\n0\n4 {x} {y} {z} {POINT_M}\n",
            radiance(4.0 * core::f64::consts::PI)
        ),
        LIGHT_POINT_LAMBERT => format!(
            "void light l{index}\n0\n0\n3 {}\nl{index} ring p{index}\n0\n0\n8 {x} {y} {z} {ax} {ay} {az} 0 {POINT_M}\n",
            radiance(core::f64::consts::PI)
        ),
        LIGHT_SPOT => {
            let [inner, outer] = record.cone.map(f64::from);
            let steradians = enf_layout::light::cone_steradians(record.cone);
            // A hard edge where the flux is the same.
            let edge = 1.0 - steradians / core::f64::consts::TAU;
            if inner - outer > 1e-6 {
                notes.light(&light.name, "its fading edge became a hard one, of the same flux");
            }
            let angle = 2.0 * libm::acos(edge.clamp(-1.0, 1.0)).to_degrees();
            format!(
                "void spotlight l{index}\n0\n0\n7 {} {angle} {ax} {ay} {az}\nl{index} sphere p{index}\n0\n0\n4 {x} {y} {z} {POINT_M}\n",
                radiance(steradians)
            )
        }
        _ => {
            notes.light(&light.name, "left out: ies2rad makes one of its file");
            String::new()
        }
    }
}

fn camera(view: &View, shown: Shown) -> String {
    let record = &view.record;
    let aspect = record.width as f32 / record.height as f32;
    let (kind, across, high) = match shown {
        Shown::Perspective(fov) => {
            let half = libm::tanf(fov.to_radians() * 0.5) * aspect;
            ("v", 2.0 * libm::atanf(half).to_degrees(), fov)
        }
        Shown::Plan([width, height]) => ("l", width, height),
    };
    let (eye, target) = (Vec3::from(record.eye), Vec3::from(record.target));
    let ahead = (target - eye).normalize_or_zero();
    let [ux, uy, uz] = record.up;
    format!(
        "rvu -vt{kind} -vp {} {} {} -vd {} {} {} -vu {ux} {uy} {uz} -vh {across} -vv {high}\n",
        eye.x, eye.y, eye.z, ahead.x, ahead.y, ahead.z
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use enf_layout::light::LightRecord;

    fn material(diffuse: f32, specular: f32) -> MaterialRecord {
        MaterialRecord { diffuse: [diffuse; 3], specular: [specular; 3], ..MaterialRecord::BLACK }
    }

    fn numbers(text: &str) -> Vec<f64> {
        text.lines().last().unwrap().split(' ').skip(1).map(|n| n.parse().unwrap()).collect()
    }

    #[test]
    fn reflectances_are_kept() {
        let mut said = Vec::new();
        let mut of = |m: &MaterialRecord| matter(3, m, m.diffuse, &mut said);
        assert_eq!(of(&material(0.5, 0.0)), "void plastic m3\n0\n0\n5 0.5 0.5 0.5 0 0\n");
        assert_eq!(of(&material(0.0, 0.75)), "void metal m3\n0\n0\n5 0.75 0.75 0.75 1 0\n");
        // Plastic's diffuse part is its colour times what is not mirrored.
        let mixed = numbers(&of(&material(0.5, 0.25)));
        assert!((mixed[0] * (1.0 - mixed[3]) - 0.5).abs() < 1e-6 && (mixed[3] - 0.25).abs() < 1e-6);
        assert!(said.is_empty());
    }

    #[test]
    fn a_pane_passes_as_much_straight_on() {
        let pane = MaterialRecord { transmission: [0.8; 3], index: 1.5, ..MaterialRecord::BLACK };
        let mut said = Vec::new();
        let text = numbers(&matter(0, &pane, [0.0; 3], &mut said));
        let (t, r) = (text[0], 0.04f64);
        let through = (1.0 - r) * (1.0 - r) * t / (1.0 - r * r * t * t);
        assert!((through - 0.8 * 0.96).abs() < 1e-6, "{through}");
        assert_eq!(said.len(), 1);
    }

    #[test]
    fn points_keep_their_intensity() {
        let mut notes = Notes::default();
        let mut light = Light {
            name: "p".into(),
            record: LightRecord {
                kind: LIGHT_POINT,
                flux_w: [4.0 * core::f32::consts::PI, 0.0, 0.0],
                axis: [0.0, 0.0, -1.0],
                ..LightRecord::DARK
            },
            emitters: Vec::new(),
            profile: None,
        };
        let radiance = |text: &str| -> f64 {
            text.lines().nth(3).unwrap().split(' ').nth(1).unwrap().parse().unwrap()
        };
        // A sphere's intensity is its radiance times its cross-section.
        let disc = core::f64::consts::PI * 25e-6;
        let of = source(0, &light, &mut notes);
        assert!((radiance(&of) * disc - 1.0).abs() < 1e-6, "{of}");
        // A hemisphere of it has twice that.
        light.record.kind = LIGHT_SPOT;
        light.record.cone = [0.0, 0.0];
        let of = source(0, &light, &mut notes);
        assert!((radiance(&of) * disc - 2.0).abs() < 1e-6 && of.contains(" 180 0 0 -1"), "{of}");
        assert!(notes.0.is_empty());
    }

    #[test]
    fn emitters_face_as_their_triangles_do() {
        let building = crate::building::samples::lamp();
        let text = scene(&building, &mut Notes::default());
        assert!(text.contains("void light e0\n0\n0\n3 5 4 3\n"), "{text}");
        assert!(text.contains("e0 polygon t0\n0\n0\n9 0 0 2 0 1 2 1 0 2\n"), "{text}");
        // Listed twice, it emits once.
        assert!(text.contains("m0 polygon t1\n"), "{text}");
    }
}
