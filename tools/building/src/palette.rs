//! The paint shop: every material a building can name, with its reflectance.
//!
//! Reflectances are linear Rec.709, at most 0.85. Walls are warm, a few are bold, so that light
//! carries colour from room to room.

use crate::mesh::Paint;

/// What a paint does with light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Lambertian reflectance.
    Matt([f64; 3]),
    /// Mirror reflectance.
    Mirror([f64; 3]),
    /// Thin clear pane: transmittance, index of refraction.
    Glass([f64; 3], f64),
    /// Lambertian reflectance under a highlight.
    Gloss([f64; 3], [f64; 3]),
}

/// Every paint and its kind.
pub const PAINTS: &[(Paint, Kind)] = &[
    // Walls and ceilings.
    ("ceiling.white", Kind::Matt([0.82, 0.81, 0.79])),
    ("wall.white", Kind::Matt([0.78, 0.76, 0.72])),
    ("wall.cream", Kind::Matt([0.77, 0.70, 0.57])),
    ("wall.sand", Kind::Matt([0.66, 0.55, 0.41])),
    ("wall.rose", Kind::Matt([0.68, 0.47, 0.41])),
    ("wall.sage", Kind::Matt([0.46, 0.54, 0.40])),
    ("wall.red", Kind::Matt([0.52, 0.10, 0.07])),
    ("wall.terracotta", Kind::Matt([0.60, 0.24, 0.12])),
    ("wall.ochre", Kind::Matt([0.70, 0.44, 0.10])),
    ("wall.blue", Kind::Matt([0.10, 0.22, 0.45])),
    ("wall.teal", Kind::Matt([0.08, 0.32, 0.34])),
    ("wall.sky", Kind::Matt([0.42, 0.58, 0.70])),
    ("wall.green", Kind::Matt([0.12, 0.34, 0.16])),
    ("wall.plum", Kind::Matt([0.32, 0.12, 0.24])),
    ("tile.white", Kind::Matt([0.76, 0.78, 0.78])),
    ("tile.aqua", Kind::Matt([0.30, 0.58, 0.58])),
    // Floors.
    ("floor.oak", Kind::Matt([0.50, 0.32, 0.17])),
    ("floor.walnut", Kind::Matt([0.30, 0.17, 0.09])),
    ("floor.maple", Kind::Matt([0.60, 0.44, 0.27])),
    ("floor.stone", Kind::Matt([0.48, 0.44, 0.39])),
    ("floor.tile", Kind::Matt([0.52, 0.53, 0.52])),
    ("floor.terracotta", Kind::Matt([0.48, 0.22, 0.12])),
    ("floor.concrete", Kind::Matt([0.40, 0.39, 0.37])),
    ("carpet.grey", Kind::Matt([0.27, 0.27, 0.29])),
    ("carpet.blue", Kind::Matt([0.12, 0.18, 0.32])),
    ("carpet.green", Kind::Matt([0.16, 0.26, 0.16])),
    ("carpet.wine", Kind::Matt([0.32, 0.08, 0.10])),
    // Outside.
    ("facade.render", Kind::Matt([0.70, 0.65, 0.55])),
    ("facade.plinth", Kind::Matt([0.30, 0.28, 0.26])),
    ("roof.gravel", Kind::Matt([0.36, 0.35, 0.33])),
    ("ground.lawn", Kind::Matt([0.12, 0.24, 0.07])),
    ("ground.paving", Kind::Matt([0.42, 0.40, 0.37])),
    ("hedge", Kind::Matt([0.07, 0.20, 0.06])),
    // Joinery.
    ("trim.white", Kind::Matt([0.80, 0.79, 0.76])),
    ("trim.oak", Kind::Matt([0.48, 0.31, 0.17])),
    ("frame.white", Kind::Matt([0.78, 0.78, 0.76])),
    ("frame.dark", Kind::Matt([0.09, 0.09, 0.10])),
    ("stone.sill", Kind::Matt([0.62, 0.60, 0.56])),
    ("door.white", Kind::Matt([0.76, 0.75, 0.71])),
    ("door.oak", Kind::Matt([0.46, 0.28, 0.14])),
    ("door.blue", Kind::Matt([0.16, 0.26, 0.40])),
    // Wood.
    ("wood.oak", Kind::Matt([0.52, 0.34, 0.18])),
    ("wood.walnut", Kind::Matt([0.28, 0.15, 0.08])),
    ("wood.birch", Kind::Matt([0.66, 0.52, 0.34])),
    ("wood.cherry", Kind::Matt([0.44, 0.18, 0.09])),
    ("wood.black", Kind::Matt([0.05, 0.045, 0.04])),
    // Lacquer, metal, plastic.
    ("lacquer.white", Kind::Matt([0.80, 0.80, 0.78])),
    ("lacquer.grey", Kind::Matt([0.42, 0.43, 0.44])),
    ("lacquer.red", Kind::Matt([0.58, 0.07, 0.05])),
    ("lacquer.green", Kind::Matt([0.20, 0.36, 0.28])),
    ("lacquer.blue", Kind::Matt([0.12, 0.26, 0.46])),
    ("lacquer.yellow", Kind::Matt([0.76, 0.56, 0.10])),
    ("metal.steel", Kind::Matt([0.55, 0.55, 0.56])),
    ("metal.chrome", Kind::Matt([0.66, 0.67, 0.68])),
    ("metal.dark", Kind::Matt([0.14, 0.14, 0.15])),
    ("metal.brass", Kind::Matt([0.62, 0.44, 0.16])),
    ("metal.copper", Kind::Matt([0.62, 0.32, 0.20])),
    ("plastic.black", Kind::Matt([0.04, 0.04, 0.045])),
    ("plastic.grey", Kind::Matt([0.35, 0.36, 0.37])),
    ("plastic.white", Kind::Matt([0.76, 0.76, 0.76])),
    ("rubber", Kind::Matt([0.06, 0.06, 0.06])),
    ("screen", Kind::Matt([0.03, 0.035, 0.05])),
    ("screen.text", Kind::Matt([0.30, 0.42, 0.55])),
    // Cloth and leather.
    ("fabric.cream", Kind::Matt([0.72, 0.66, 0.54])),
    ("fabric.white", Kind::Matt([0.80, 0.79, 0.76])),
    ("fabric.grey", Kind::Matt([0.36, 0.36, 0.37])),
    ("fabric.charcoal", Kind::Matt([0.12, 0.12, 0.13])),
    ("fabric.red", Kind::Matt([0.56, 0.09, 0.08])),
    ("fabric.orange", Kind::Matt([0.70, 0.28, 0.07])),
    ("fabric.mustard", Kind::Matt([0.66, 0.45, 0.10])),
    ("fabric.green", Kind::Matt([0.14, 0.34, 0.18])),
    ("fabric.teal", Kind::Matt([0.07, 0.34, 0.36])),
    ("fabric.blue", Kind::Matt([0.10, 0.20, 0.46])),
    ("fabric.navy", Kind::Matt([0.05, 0.08, 0.19])),
    ("fabric.plum", Kind::Matt([0.34, 0.12, 0.28])),
    ("fabric.rose", Kind::Matt([0.70, 0.42, 0.42])),
    ("felt.green", Kind::Matt([0.05, 0.36, 0.18])),
    ("leather.brown", Kind::Matt([0.30, 0.14, 0.06])),
    ("leather.black", Kind::Matt([0.05, 0.048, 0.045])),
    ("leather.tan", Kind::Matt([0.52, 0.30, 0.14])),
    ("shade", Kind::Matt([0.76, 0.68, 0.52])),
    // Ceramics, stone, paper.
    ("ceramic.white", Kind::Matt([0.82, 0.82, 0.81])),
    ("ceramic.blue", Kind::Matt([0.14, 0.28, 0.52])),
    ("ceramic.green", Kind::Matt([0.22, 0.46, 0.36])),
    ("ceramic.red", Kind::Matt([0.60, 0.14, 0.08])),
    ("ceramic.ochre", Kind::Matt([0.68, 0.46, 0.16])),
    ("stone.white", Kind::Matt([0.74, 0.72, 0.69])),
    ("stone.dark", Kind::Matt([0.10, 0.10, 0.11])),
    ("paper", Kind::Matt([0.80, 0.77, 0.69])),
    ("cardboard", Kind::Matt([0.46, 0.32, 0.19])),
    ("pot.clay", Kind::Matt([0.54, 0.24, 0.13])),
    ("pot.white", Kind::Matt([0.76, 0.75, 0.72])),
    ("pot.dark", Kind::Matt([0.12, 0.12, 0.13])),
    ("soil", Kind::Matt([0.08, 0.05, 0.03])),
    ("leaf.green", Kind::Matt([0.12, 0.36, 0.08])),
    ("leaf.dark", Kind::Matt([0.06, 0.24, 0.07])),
    ("leaf.light", Kind::Matt([0.34, 0.52, 0.14])),
    ("bark", Kind::Matt([0.24, 0.15, 0.09])),
    ("fruit.orange", Kind::Matt([0.80, 0.34, 0.04])),
    ("fruit.apple", Kind::Matt([0.60, 0.12, 0.05])),
    ("fruit.lime", Kind::Matt([0.42, 0.56, 0.10])),
    // Books.
    ("book.red", Kind::Matt([0.50, 0.07, 0.06])),
    ("book.wine", Kind::Matt([0.28, 0.05, 0.07])),
    ("book.orange", Kind::Matt([0.68, 0.28, 0.06])),
    ("book.yellow", Kind::Matt([0.74, 0.56, 0.12])),
    ("book.green", Kind::Matt([0.10, 0.30, 0.13])),
    ("book.olive", Kind::Matt([0.32, 0.32, 0.12])),
    ("book.teal", Kind::Matt([0.08, 0.34, 0.36])),
    ("book.blue", Kind::Matt([0.08, 0.18, 0.44])),
    ("book.navy", Kind::Matt([0.04, 0.07, 0.17])),
    ("book.violet", Kind::Matt([0.28, 0.12, 0.34])),
    ("book.brown", Kind::Matt([0.30, 0.17, 0.09])),
    ("book.black", Kind::Matt([0.05, 0.05, 0.05])),
    ("book.grey", Kind::Matt([0.44, 0.43, 0.41])),
    ("book.cream", Kind::Matt([0.74, 0.68, 0.54])),
    ("book.white", Kind::Matt([0.78, 0.77, 0.74])),
    // Lamps.
    ("lamp.housing", Kind::Matt([0.78, 0.78, 0.77])),
    // The few that are not matt.
    ("mirror", Kind::Mirror([0.84, 0.85, 0.84])),
    ("glass.pane", Kind::Glass([0.90, 0.92, 0.91], 1.5)),
];

/// Paints with a highlight, of the buildings that came after the L-shape.
pub const POLISHED: &[(Paint, Kind)] = &[
    ("stone.polished", Kind::Gloss([0.46, 0.43, 0.38], [0.12, 0.12, 0.12])),
    ("floor.parquet", Kind::Gloss([0.44, 0.27, 0.14], [0.08, 0.08, 0.08])),
    ("lacquer.gloss", Kind::Gloss([0.36, 0.05, 0.08], [0.15, 0.15, 0.15])),
    ("metal.brushed", Kind::Gloss([0.34, 0.34, 0.35], [0.4, 0.4, 0.41])),
];

/// The spines of a library.
pub const BOOKS: &[Paint] = &[
    "book.red",
    "book.wine",
    "book.orange",
    "book.yellow",
    "book.green",
    "book.olive",
    "book.teal",
    "book.blue",
    "book.navy",
    "book.violet",
    "book.brown",
    "book.black",
    "book.grey",
    "book.cream",
    "book.white",
];

/// The paint of every luminaire's emitting side; scenes give it one material per lumen value.
pub const PANEL: Paint = "panel";

/// Every paint of the shop.
pub fn all() -> impl Iterator<Item = &'static (Paint, Kind)> {
    PAINTS.iter().chain(POLISHED)
}

/// The kind of a paint; `None` for a name that is not in the shop.
pub fn kind(paint: &str) -> Option<Kind> {
    all().find(|(name, _)| *name == paint).map(|&(_, kind)| kind)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paints_are_unique_and_physical() {
        for (i, (name, kind)) in all().enumerate() {
            assert!(all().take(i).all(|(other, _)| other != name), "{name} twice");
            let (Kind::Matt(c) | Kind::Mirror(c) | Kind::Glass(c, _) | Kind::Gloss(c, _)) = kind;
            if let Kind::Gloss(c, ks) = kind {
                assert!((0..3).all(|k| ks[k] > 0.0 && c[k] + ks[k] <= 0.85), "{name}");
            }
            assert!(c.iter().all(|&c| c > 0.0 && c <= 0.93), "{name}");
            if !matches!(kind, Kind::Glass(..)) {
                assert!(c.iter().all(|&c| c <= 0.85), "{name} brighter than anything built");
            }
        }
        assert!(BOOKS.iter().all(|b| kind(b).is_some()));
    }
}
