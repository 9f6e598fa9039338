//! A scene for Mitsuba 3 (Jakob et al. 2022): XML, binary PLY meshes, textures as float maps.
//!
//! `scene.xml` has materials, meshes and lights; `VIEW.xml` has a camera, a film with a box filter, the integrator `path`, and
//! includes the former. So
//!
//! ```text
//! mitsuba -m scalar_rgb VIEW.xml -Dspp=1024 -Dmax_depth=-1 -o VIEW.exr
//! ```
//!
//! | here | there |
//! |---|---|
//! | Lambert, mirror, mixtures of them | `diffuse`, `conductor` without material, `blendbsdf`; two-sided |
//! | gloss on matter | `roughplastic` (or `plastic`), linear: its coupling is Kelemen's too; Fresnel instead of Schlick |
//! | gloss alone | `roughconductor` with real indices of the same reflectance straight on |
//! | see-through sheet | `thindielectric` of the same reflectance straight on |
//! | solid glass | `dielectric`; absorption and polarisation are lost |
//! | area lights | `area` on the front of their triangles, and of them alone |
//! | points; spots; measured luminaires | `point`; `spot` with a texture for its fading; likewise, as far as 80 degrees |
//! | Lambertian points | a disc of 1 mm |

use std::fmt::Write as _;
use std::path::Path;

use enf_layout::NONE;
use enf_layout::light::{
    LIGHT_AREA, LIGHT_POINT, LIGHT_POINT_LAMBERT, LIGHT_PROFILE, LIGHT_SPOT, cone_steradians,
};
use enf_layout::material::{MATERIAL_GLOSS, MATERIAL_SOLID, MaterialRecord, SMOOTHEST_GLOSS};
use enf_layout::texture::{TEXTURE_CLAMP_X, TEXTURE_CLAMP_Y, TEXTURE_MIRROR_X, TEXTURE_MIRROR_Y};
use enf_scene::View;
use enf_stage::Result;
use enf_stage::failure::IoContext;
use enf_transport::lamp;
use glam::{DVec3, Vec3};

use crate::building::{Building, Light, Picture, Triangle};
use crate::view::{Shown, shown};
use crate::{Notes, pfm};

/// Side of a texture that says how a light's intensity changes over its cone, texels.
const INTENSITY_TEXELS: u32 = 512;
/// A measured luminaire is cut off at this angle to its axis, degrees: a plane cannot show more.
const WIDEST: f64 = 80.0;
/// Radius of the disc that a Lambertian point becomes, m.
const DISC_M: f64 = 1e-3;

/// Writes `scene.xml`, `VIEW.xml` for each view, and what they need, into a folder that is made if it is not there.
/// Returns what has no faithful counterpart.
///
/// # Errors
/// Exit 5 when a file cannot be written.
pub fn write(building: &Building, views: &[View], folder: &Path) -> Result<Notes> {
    std::fs::create_dir_all(folder).at("create", folder)?;
    let mut notes = Notes::default();
    let scene = scene(building, folder, &mut notes)?;
    let path = folder.join("scene.xml");
    std::fs::write(&path, scene).at("write", &path)?;
    for view in views {
        match shown(view) {
            Ok(shown) => {
                let path = folder.join(format!("{}.xml", view.name));
                std::fs::write(&path, camera(view, shown)).at("write", &path)?;
            }
            Err(why) => notes.view(&view.name, why),
        }
    }
    Ok(notes)
}

fn scene(building: &Building, folder: &Path, notes: &mut Notes) -> Result<String> {
    let mut xml = String::from("<scene version=\"3.0.0\">\n");
    let groups = building.groups();
    let mut textured = vec![false; building.pictures.len()];
    // Each material once plain and once with its picture, as far as triangles want it.
    let mut wanted: Vec<(u32, bool)> = groups.iter().map(|(key, _)| (key.0, key.2)).collect();
    wanted.sort_unstable();
    wanted.dedup();
    let mut named = NONE;
    for (material, on_picture) in wanted {
        let (name, record) = &building.materials[material as usize];
        let picture = building.pictures.get(record.texture as usize);
        let diffuse = match picture {
            Some(picture) if on_picture => {
                let file = format!("m{material}.pfm");
                let kd = record.diffuse;
                let texels: Vec<[f32; 3]> = (picture.texels.iter())
                    .map(|t| [0, 1, 2].map(|c| (t[c] * kd[c]).clamp(0.0, 1.0)))
                    .collect();
                pfm::write(&folder.join(&file), picture.width, picture.height, &texels)?;
                if let Some(seen) = textured.get_mut(record.texture as usize) {
                    *seen = true;
                }
                Reflectance::Picture(file, wrap(picture, name, notes))
            }
            Some(picture) => {
                Reflectance::Colour([0, 1, 2].map(|c| record.diffuse[c] * picture.mean[c]))
            }
            None => Reflectance::Colour(record.diffuse),
        };
        let mut said = Vec::new();
        let bsdf = bsdf(record, &diffuse, &mut said);
        if named != material {
            said.into_iter().for_each(|what| notes.material(name, what));
            named = material;
        }
        let id = id(material, on_picture);
        let _ = writeln!(xml, "\t<!-- {} -->", comment(name));
        xml += &bsdf.replacen("<bsdf ", &format!("<bsdf id=\"{id}\" "), 1);
        xml.push('\n');
    }
    for ((material, light, on_picture), triangles) in &groups {
        let file = match *light {
            NONE => format!("{}.ply", id(*material, *on_picture)),
            light => format!("{}-l{light}.ply", id(*material, *on_picture)),
        };
        let path = folder.join(&file);
        std::fs::write(&path, ply(triangles, *on_picture)).at("write", &path)?;
        let _ = writeln!(
            xml,
            "\t<shape type=\"ply\">\n\t\t<string name=\"filename\" value=\"{file}\"/>\n\t\t\
             <boolean name=\"face_normals\" value=\"true\"/>\n\t\t<ref id=\"{}\"/>",
            id(*material, *on_picture)
        );
        if *light != NONE {
            let emission = building.materials[*material as usize].1.emission;
            let _ =
                writeln!(xml, "\t\t<emitter type=\"area\">{}</emitter>", rgb("radiance", emission));
        }
        xml += "\t</shape>\n";
    }
    for (index, light) in building.lights.iter().enumerate() {
        xml += &emitter(index, light, folder, notes)?;
    }
    if building.daylight {
        notes.light("sky", "left out: daylight has no counterpart here");
    }
    xml += "</scene>\n";
    Ok(xml)
}

fn id(material: u32, on_picture: bool) -> String {
    format!("m{material}{}", if on_picture { "t" } else { "" })
}

/// A name inside a comment.
fn comment(name: &str) -> String {
    name.replace("--", "- -").chars().filter(|c| !c.is_control()).collect()
}

fn rgb(name: &str, v: [f32; 3]) -> String {
    format!("<rgb name=\"{name}\" value=\"{} {} {}\"/>", v[0], v[1], v[2])
}

fn float(name: &str, v: f64) -> String {
    format!("<float name=\"{name}\" value=\"{v}\"/>")
}

/// What a Lambert surface reflects.
enum Reflectance {
    Colour([f32; 3]),
    /// A file, and how it goes on beyond its borders.
    Picture(String, &'static str),
}

impl Reflectance {
    /// Divided by a blend's share of it; a picture is left as it is.
    fn xml(&self, name: &str, share: f32) -> String {
        match self {
            Self::Colour(colour) => rgb(name, colour.map(|v| (v / share).clamp(0.0, 1.0))),
            Self::Picture(file, wrap) => format!(
                "<texture name=\"{name}\" type=\"bitmap\"><string name=\"filename\" value=\"{file}\"/>\
                 <string name=\"wrap_mode\" value=\"{wrap}\"/><boolean name=\"raw\" value=\"true\"/></texture>"
            ),
        }
    }

    fn is_black(&self) -> bool {
        matches!(self, Self::Colour(colour) if *colour == [0.0; 3])
    }
}

fn wrap(picture: &Picture, name: &str, notes: &mut Notes) -> &'static str {
    let of = |clamp, mirror| match (picture.flags & clamp, picture.flags & mirror) {
        (0, 0) => "repeat",
        (0, _) => "mirror",
        _ => "clamp",
    };
    let x = of(TEXTURE_CLAMP_X, TEXTURE_MIRROR_X);
    if x != of(TEXTURE_CLAMP_Y, TEXTURE_MIRROR_Y) {
        notes.material(name, "its texture goes on alike in both directions, not as modelled");
    }
    x
}

fn twosided(inner: &str) -> String {
    format!("\t<bsdf type=\"twosided\">{inner}</bsdf>")
}

fn largest(colour: [f32; 3]) -> f32 {
    colour.into_iter().fold(0.0, f32::max)
}

/// The refractive index whose reflectance straight on is `f0`.
fn index_of(f0: f32) -> f64 {
    let root = f64::from(f0.clamp(1e-6, 0.999)).sqrt();
    (1.0 + root) / (1.0 - root)
}

/// A material; what it lacks goes to `said`.
fn bsdf(record: &MaterialRecord, diffuse: &Reflectance, said: &mut Vec<&'static str>) -> String {
    let outside = float("ext_ior", 1.0);
    let (specular, transmission) = (record.specular, record.transmission);
    if record.flags & MATERIAL_SOLID != 0 {
        if largest(record.absorption) > 0.0 {
            said.push("its inside does not absorb in the exported scene");
        }
        let inside = float("int_ior", f64::from(record.index));
        let tint = rgb("specular_transmittance", transmission);
        return format!("\t<bsdf type=\"dielectric\">{outside}{inside}{tint}</bsdf>");
    }
    if record.flags & MATERIAL_GLOSS != 0 {
        return gloss(record, diffuse, said);
    }
    let lambert =
        |share| format!("<bsdf type=\"diffuse\">{}</bsdf>", diffuse.xml("reflectance", share));
    if largest(transmission) > 0.0 {
        let root = (f64::from(record.index) - 1.0) / (f64::from(record.index) + 1.0);
        let reflects = root * root;
        // Two faces and what goes to and fro between them reflect 2 R / (1 + R).
        let index = index_of((reflects / (2.0 - reflects)) as f32);
        let index = if record.index > 1.0 { index } else { 1.0 };
        if record.index > 1.0 {
            said.push("a sheet of one interface became a thin pane that reflects as much straight on; aslant they differ");
        } else if largest(specular) > 0.0 {
            said.push("what a sheet without refraction mirrors is lost");
        }
        let pane = |share: f32| {
            let tint = transmission.map(|t| (t / share).min(1.0));
            format!(
                "<bsdf type=\"thindielectric\">{outside}{}{}</bsdf>",
                float("int_ior", index),
                rgb("specular_transmittance", tint)
            )
        };
        if diffuse.is_black() {
            return format!("\t{}", pane(1.0));
        }
        said.push("the diffuse part of a pane is mixed with the clear one whatever the angle, and mirrors less");
        let share = match diffuse {
            Reflectance::Colour(colour) => share(*colour, transmission, said),
            Reflectance::Picture(..) => 1.0 - largest(transmission),
        };
        return format!(
            "\t<bsdf type=\"blendbsdf\">{}{}{}</bsdf>",
            float("weight", f64::from(1.0 - share)),
            lambert(share),
            pane(1.0 - share)
        );
    }
    if specular == [0.0; 3] {
        return twosided(&lambert(1.0));
    }
    let mirror = |share: f32| {
        format!(
            "<bsdf type=\"conductor\"><string name=\"material\" value=\"none\"/>{}</bsdf>",
            rgb("specular_reflectance", specular.map(|v| (v / share).min(1.0)))
        )
    };
    if diffuse.is_black() {
        return twosided(&mirror(1.0));
    }
    let share = match diffuse {
        Reflectance::Colour(colour) => share(*colour, specular, said),
        Reflectance::Picture(..) => {
            said.push("its texture is mixed with a mirror, and darker by the mirror's share");
            1.0 - largest(specular)
        }
    };
    twosided(&format!(
        "<bsdf type=\"blendbsdf\">{}{}{}</bsdf>",
        float("weight", f64::from(1.0 - share)),
        lambert(share),
        mirror(1.0 - share)
    ))
}

/// The first one's share in a blend of two, both divided by their shares still within 1: between what each needs.
fn share(first: [f32; 3], second: [f32; 3], said: &mut Vec<&'static str>) -> f32 {
    let (least, most) = (largest(first), 1.0 - largest(second));
    if least > most + 1e-6 {
        said.push(
            "its two parts reflect more than 1 together, in different colours: they are cut down",
        );
    }
    (0.5 * (least + most)).clamp(1e-3, 1.0 - 1e-3)
}

fn gloss(record: &MaterialRecord, diffuse: &Reflectance, said: &mut Vec<&'static str>) -> String {
    let f0 = record.specular;
    let rough = record.roughness >= SMOOTHEST_GLOSS;
    let facets = if rough {
        format!(
            "<string name=\"distribution\" value=\"ggx\"/>{}",
            float("alpha", f64::from(record.roughness))
        )
    } else {
        String::new()
    };
    said.push("Fresnel's reflectance rises after its equations, not after Schlick");
    if diffuse.is_black() {
        let [r, g, b] = f0.map(index_of);
        let kind = if rough { "roughconductor" } else { "conductor" };
        return twosided(&format!(
            "<bsdf type=\"{kind}\">{facets}{}<rgb name=\"eta\" value=\"{r} {g} {b}\"/>{}</bsdf>",
            float("ext_eta", 1.0),
            rgb("k", [0.0; 3]),
        ));
    }
    let top = largest(f0);
    let tint = if top > 0.0 { f0.map(|v| v / top) } else { [1.0; 3] };
    if tint != [1.0; 3] {
        said.push("its coloured gloss has one refractive index, and the matter below it misses what the largest of its colours reflects");
    }
    let kind = if rough { "roughplastic" } else { "plastic" };
    twosided(&format!(
        "<bsdf type=\"{kind}\">{facets}{}{}<boolean name=\"nonlinear\" value=\"false\"/>{}{}</bsdf>",
        float("int_ior", index_of(top)),
        float("ext_ior", 1.0),
        rgb("specular_reflectance", tint),
        diffuse.xml("diffuse_reflectance", 1.0),
    ))
}

fn ply(triangles: &[&Triangle], on_picture: bool) -> Vec<u8> {
    let places = if on_picture { "property float u\nproperty float v\n" } else { "" };
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n{places}\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        triangles.len() * 3,
        triangles.len()
    )
    .into_bytes();
    for triangle in triangles {
        for (i, corner) in triangle.corners.iter().enumerate() {
            bytes.extend(corner.iter().flat_map(|v| v.to_le_bytes()));
            if let Some(places) = triangle.places.filter(|_| on_picture) {
                bytes.extend(places[i].iter().flat_map(|v| v.to_le_bytes()));
            }
        }
    }
    for i in 0..triangles.len() as i32 {
        bytes.push(3);
        bytes.extend([3 * i, 3 * i + 1, 3 * i + 2].iter().flat_map(|v| v.to_le_bytes()));
    }
    bytes
}

fn look_at(origin: Vec3, target: Vec3, up: Vec3) -> String {
    let point = |v: Vec3| format!("{}, {}, {}", v.x, v.y, v.z);
    format!(
        "<lookat origin=\"{}\" target=\"{}\" up=\"{}\"/>",
        point(origin),
        point(target),
        point(up)
    )
}

/// A direction that is not along `axis`.
fn aside(axis: Vec3) -> Vec3 {
    if axis.z.abs() < 0.9 { Vec3::Z } else { Vec3::Y }
}

/// A point light.
fn emitter(index: usize, light: &Light, folder: &Path, notes: &mut Notes) -> Result<String> {
    let record = &light.record;
    let position = Vec3::from(record.position);
    let axis = Vec3::from(record.axis).normalize_or(-Vec3::Z);
    let aim = look_at(position, position + axis, aside(axis));
    let flux = |factor: f64| record.flux_w.map(|f| (f64::from(f) * factor) as f32);
    let spot = |intensity, beam: f64, cutoff: f64, texture: &str| {
        format!(
            "\t<emitter type=\"spot\"><transform name=\"to_world\">{aim}</transform>{}{}{}{texture}</emitter>\n",
            rgb("intensity", intensity),
            float("cutoff_angle", cutoff.to_degrees()),
            float("beam_width", beam.to_degrees())
        )
    };
    match record.kind {
        LIGHT_AREA => Ok(String::new()),
        LIGHT_POINT => Ok(format!(
            "\t<emitter type=\"point\"><point name=\"position\" x=\"{}\" y=\"{}\" z=\"{}\"/>{}</emitter>\n",
            position.x,
            position.y,
            position.z,
            rgb("intensity", flux(0.25 * core::f64::consts::FRAC_1_PI))
        )),
        LIGHT_POINT_LAMBERT => {
            notes.light(&light.name, "a Lambertian point became a disc of 1 mm");
            let area = core::f64::consts::PI * DISC_M * DISC_M;
            let radiance = flux(1.0 / (core::f64::consts::PI * area));
            Ok(format!(
                "\t<shape type=\"disk\"><transform name=\"to_world\"><scale value=\"{DISC_M}\"/>{aim}</transform>\
                 <bsdf type=\"diffuse\">{}</bsdf><emitter type=\"area\">{}</emitter></shape>\n",
                rgb("reflectance", [0.0; 3]),
                rgb("radiance", radiance)
            ))
        }
        LIGHT_SPOT => {
            let [inner, outer] = record.cone.map(|c| libm::acos(f64::from(c).clamp(-1.0, 1.0)));
            let axial = flux(1.0 / cone_steradians(record.cone));
            if outer - inner < 1e-4 {
                return Ok(spot(axial, outer, outer, ""));
            }
            if outer.to_degrees() > WIDEST {
                notes.light(
                    &light.name,
                    "a wide spot that fades evenly with the angle, of the same flux",
                );
                let fading = 1.0 - (libm::sin(outer) - libm::sin(inner)) / (outer - inner);
                let even = flux(1.0 / (core::f64::consts::TAU * fading));
                return Ok(spot(even, inner, outer, ""));
            }
            let texture = intensities(index, folder, axis, outer, |to| {
                lamp::spot(record, to) * cone_steradians(record.cone)
            })?;
            Ok(spot(axial, outer, outer, &texture))
        }
        LIGHT_PROFILE => match light.profile() {
            Some(profile) => {
                let reach = f64::from(*profile.polar.last().unwrap_or(&0.0));
                let cut = reach.min(WIDEST.to_radians());
                let peak = (profile.intensity.iter().copied().fold(0.0, f32::max)).max(1e-30);
                let inside: f64 = (0..profile.polar.len() - 1)
                    .filter(|&row| f64::from(profile.polar[row + 1]) <= cut + 1e-6)
                    .map(|row| profile.band(row))
                    .sum();
                let what = format!(
                    "its measured intensities became a texture of a spot up to {:.0} degrees; at most {:.1} % of its light is lost",
                    cut.to_degrees(),
                    100.0 * (1.0 - inside).max(0.0)
                );
                notes.light(&light.name, &what);
                let texture = intensities(index, folder, axis, cut, |to| {
                    lamp::measured(record, &profile, to) / f64::from(peak)
                })?;
                Ok(spot(flux(f64::from(peak)), cut, cut, &texture))
            }
            None => {
                notes.light(&light.name, "left out: its measured intensities are damaged");
                Ok(String::new())
            }
        },
        _ => {
            notes.light(&light.name, "left out: it has no counterpart");
            Ok(String::new())
        }
    }
}

/// A texture over a spot's cone (half its opening in radians): intensity by direction, at most 1.
fn intensities(
    index: usize,
    folder: &Path,
    axis: Vec3,
    half: f64,
    intensity: impl Fn(Vec3) -> f64,
) -> Result<String> {
    // The axes of what `lookat` makes.
    let forward = axis.as_dvec3();
    let left = aside(axis).as_dvec3().cross(forward).normalize_or(DVec3::X);
    let up = forward.cross(left);
    let (side, tan) = (INTENSITY_TEXELS, libm::tan(half));
    let at = |i: u32| (2.0 * (f64::from(i) + 0.5) / f64::from(side) - 1.0) * tan;
    let mut texels = Vec::with_capacity(side as usize * side as usize);
    for row in 0..side {
        for column in 0..side {
            let to = forward + left * at(column) + up * at(row);
            texels.push([intensity(to.normalize().as_vec3()) as f32; 3]);
        }
    }
    let file = format!("l{index}.pfm");
    pfm::write(&folder.join(&file), side, side, &texels)?;
    let texture = Reflectance::Picture(file, "clamp");
    Ok(texture.xml("texture", 1.0))
}

fn camera(view: &View, shown: Shown) -> String {
    let record = &view.record;
    let (eye, target) = (Vec3::from(record.eye), Vec3::from(record.target));
    let aim = look_at(eye, target, Vec3::from(record.up));
    let sensor = match shown {
        Shown::Perspective(fov) => format!(
            "<sensor type=\"perspective\">\n\t\t<string name=\"fov_axis\" value=\"y\"/>{}{}\n\t\t<transform name=\"to_world\">{aim}</transform>",
            float("fov", f64::from(fov)),
            float("near_clip", 1e-3)
        ),
        Shown::Plan([width, _]) => {
            let half = width * 0.5;
            format!(
                "<sensor type=\"orthographic\">\n\t\t{}\n\t\t<transform name=\"to_world\"><scale x=\"{half}\" y=\"{half}\"/>{aim}</transform>",
                float("near_clip", 1e-3)
            )
        }
    };
    format!(
        "<scene version=\"3.0.0\">\n\t<default name=\"spp\" value=\"64\"/>\n\t<default name=\"max_depth\" value=\"-1\"/>\n\t\
         <integrator type=\"path\"><integer name=\"max_depth\" value=\"$max_depth\"/></integrator>\n\t{sensor}\n\t\t\
         <sampler type=\"independent\"><integer name=\"sample_count\" value=\"$spp\"/></sampler>\n\t\t\
         <film type=\"hdrfilm\"><integer name=\"width\" value=\"{}\"/><integer name=\"height\" value=\"{}\"/>\
         <string name=\"pixel_format\" value=\"rgb\"/><string name=\"component_format\" value=\"float32\"/><rfilter type=\"box\"/></film>\n\t\
         </sensor>\n\t<include filename=\"scene.xml\"/>\n</scene>\n",
        record.width, record.height
    )
}

#[cfg(test)]
mod tests;
