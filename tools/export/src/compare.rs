//! How far our picture is from another renderer's, room by room.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use enf_image::{Loaded, luminance};
use enf_stage::{Failure, Result};

/// What is compared.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Options {
    /// Pixels that see this room and no other; no others.
    pub mask_room: Option<u32>,
    /// Pixels that are as bright or brighter in either picture, by luminance, are left out: lamps.
    pub below: Option<f32>,
    /// Layer of ours instead of all light: `direct`, say.
    pub layer: Option<String>,
}

/// Which pixels are taken together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Pixels {
    /// All of them.
    All,
    /// Those of which all samples see this room, as ours has it.
    Room(u32),
    /// Those whose samples see several rooms: nobody can tell how much of a pixel's light is whose.
    Mixed,
}

/// Pixels of one room, or others.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Which.
    pub of: Pixels,
    /// Pixels compared.
    pub pixels: u64,
    /// Mean radiance of ours, W/m2/sr.
    pub ours: [f64; 3],
    /// Mean radiance of theirs, W/m2/sr.
    pub theirs: [f64; 3],
    /// Mean over pixels and channels of (ours - theirs)^2 / (theirs^2 + epsilon).
    pub rel_mse: f64,
}

impl Row {
    /// Ours over theirs by channel; 1 where both are black.
    pub fn ratios(&self) -> [f64; 3] {
        [0, 1, 2].map(|c| ratio(self.ours[c], self.theirs[c]))
    }

    /// Ours over theirs, by luminance.
    pub fn ratio(&self) -> f64 {
        let luminance = |v: [f64; 3]| 0.2126 * v[0] + 0.7152 * v[1] + 0.0722 * v[2];
        ratio(luminance(self.ours), luminance(self.theirs))
    }

    /// The largest distance of a ratio from 1, by channel or luminance.
    pub fn off(&self) -> f64 {
        let [r, g, b] = self.ratios();
        [r, g, b, self.ratio()].iter().fold(0.0, |most, x| (x - 1.0).abs().max(most))
    }
}

fn ratio(ours: f64, theirs: f64) -> f64 {
    if ours == theirs { 1.0 } else { ours / theirs }
}

/// What came out.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// All pixels first, then rooms, ascending, then those that see several.
    pub rows: Vec<Row>,
    /// Pixels left out: not finite in one of the pictures.
    pub not_finite: u64,
    /// Pixels left out: too bright.
    pub bright: u64,
    /// Of the relMSE: the square of a tenth of theirs' mean luminance, (W/m2/sr)^2.
    pub epsilon: f64,
}

/// Compares our picture with another one of the same view, the reference.
///
/// # Errors
/// Exit 4: the sizes differ, a channel is missing, or nothing is left to compare.
pub fn compare(ours: &Loaded, theirs: &Loaded, options: &Options) -> Result<Comparison> {
    if (ours.width, ours.height) != (theirs.width, theirs.height) {
        return Err(Failure::input(format!(
            "{} has {} x {} pixels, {} has {} x {}",
            ours.name, ours.width, ours.height, theirs.name, theirs.width, theirs.height
        ))
        .with_hint("render both at one size"));
    }
    let planes = |of: &Loaded, layer: Option<&str>| -> Result<Vec<[f32; 3]>> {
        let channel = |name: &str| {
            let name = layer.map_or(name.into(), |layer| format!("{layer}.{name}"));
            of.channel(&name).map(<[f32]>::to_vec).ok_or_else(|| {
                let known: Vec<&str> = of.channels.keys().map(String::as_str).collect();
                Failure::input(format!("{} has no channel {name}", of.name))
                    .with_hint(format!("it has {}", known.join(", ")))
            })
        };
        let (r, g, b) = (channel("R")?, channel("G")?, channel("B")?);
        Ok((0..r.len()).map(|i| [r[i], g[i], b[i]]).collect())
    };
    let (a, b) = (planes(ours, options.layer.as_deref())?, planes(theirs, None)?);
    let rooms = ours.channel("room.ID");
    // Pictures of earlier versions do not say.
    let mixed = ours.channel("room.mixed");
    if options.mask_room.is_some() && rooms.is_none() {
        return Err(Failure::input(format!("{} has no layer of rooms", ours.name))
            .with_hint("--mask-room wants a picture of enf-render"));
    }
    let (mut not_finite, mut bright) = (0, 0);
    let mut kept: Vec<(Option<Pixels>, [f32; 3], [f32; 3])> = Vec::with_capacity(a.len());
    for (i, (&a, &b)) in a.iter().zip(&b).enumerate() {
        let room = rooms.and_then(|r| r.get(i)).filter(|&&r| r >= 0.0);
        let of = match mixed.and_then(|m| m.get(i)) {
            Some(&mixed) if mixed > 0.0 => Some(Pixels::Mixed),
            _ => room.map(|&room| Pixels::Room(room as u32)),
        };
        if options.mask_room.is_some() && of != options.mask_room.map(Pixels::Room) {
            continue;
        }
        if !a.iter().chain(&b).all(|v| v.is_finite()) {
            not_finite += 1;
        } else if options.below.is_some_and(|most| luminance(a) >= most || luminance(b) >= most) {
            bright += 1;
        } else {
            kept.push((of, a, b));
        }
    }
    if kept.is_empty() {
        return Err(Failure::input("no pixel is left to compare")
            .with_hint("look at --mask-room and --below"));
    }
    let mean = kept.iter().map(|k| f64::from(luminance(k.2))).sum::<f64>() / kept.len() as f64;
    // Two black pictures are equal, and not a division by zero.
    let epsilon = (0.1 * mean * 0.1 * mean).max(f64::MIN_POSITIVE);
    let mut sums: BTreeMap<Pixels, Row> = BTreeMap::new();
    let mut add = |of, a: [f32; 3], b: [f32; 3]| {
        let row = sums.entry(of).or_insert(Row {
            of,
            pixels: 0,
            ours: [0.0; 3],
            theirs: [0.0; 3],
            rel_mse: 0.0,
        });
        row.pixels += 1;
        for c in 0..3 {
            let (a, b) = (f64::from(a[c]), f64::from(b[c]));
            row.ours[c] += a;
            row.theirs[c] += b;
            row.rel_mse += (a - b) * (a - b) / (b * b + epsilon) / 3.0;
        }
    };
    for (of, a, b) in kept {
        add(Pixels::All, a, b);
        if let Some(of) = of {
            add(of, a, b);
        }
    }
    let rows = sums.into_values().map(|mut row| {
        let n = row.pixels as f64;
        row.ours = row.ours.map(|v| v / n);
        row.theirs = row.theirs.map(|v| v / n);
        row.rel_mse /= n;
        row
    });
    Ok(Comparison { rows: rows.collect(), not_finite, bright, epsilon })
}

/// Rooms with less than this share of the pixels are shown and not judged.
pub const LEAST_SHARE: f64 = 0.01;

impl Comparison {
    /// The largest distance of a ratio from 1 that counts: of all pixels, and of rooms that are not tiny in the picture. (Pixels that
    /// see several rooms are few, and among all.)
    pub fn off(&self) -> f64 {
        self.rows.iter().filter(|r| self.counts(r)).fold(0.0, |most, r| r.off().max(most))
    }

    fn counts(&self, row: &Row) -> bool {
        let all = self.rows.first().map_or(0, |r| r.pixels);
        row.of != Pixels::Mixed && row.pixels as f64 >= LEAST_SHARE * all as f64
    }

    /// A table for people.
    pub fn table(&self) -> String {
        let mut text = format!(
            "{:>8} {:>9}  {:^26}  {:^26}  {:^23} {:>8}  {:>9}\n",
            "room", "pixels", "ours R G B", "theirs R G B", "ratio R G B", "Y", "relMSE"
        );
        for row in &self.rows {
            let room = match row.of {
                Pixels::All => "all".into(),
                Pixels::Room(room) => room.to_string(),
                Pixels::Mixed => "several".into(),
            };
            let [a, b] = [row.ours, row.theirs]
                .map(|v| format!("{:>8.5} {:>8.5} {:>8.5}", v[0], v[1], v[2]));
            let [r, g, b_] = row.ratios();
            let few = match row.of {
                Pixels::Mixed => "  (see several rooms: in none of them)",
                _ if self.counts(row) => "",
                _ => "  (few: not judged)",
            };
            let _ = writeln!(
                text,
                "{room:>8} {:>9}  {a}  {b}  {r:>7.4} {g:>7.4} {b_:>7.4} {:>8.4}  {:>9.3e}{few}",
                row.pixels,
                row.ratio(),
                row.rel_mse
            );
        }
        let _ = writeln!(
            text,
            "relMSE: mean of (ours - theirs)^2 / (theirs^2 + {:.3e}), that being the square of a tenth of theirs' mean luminance",
            self.epsilon
        );
        if self.not_finite + self.bright > 0 {
            let _ = writeln!(
                text,
                "left out: {} pixels too bright, {} not finite",
                self.bright, self.not_finite
            );
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(values: &[[f32; 3]], rooms: Option<&[f32]>) -> Loaded {
        let mut channels = BTreeMap::new();
        for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
            channels.insert(name.to_string(), values.iter().map(|v| v[c]).collect());
        }
        if let Some(rooms) = rooms {
            channels.insert("room.ID".into(), rooms.to_vec());
        }
        Loaded { name: "a".into(), width: values.len() as u32, height: 1, channels }
    }

    #[test]
    fn rooms_are_compared_apart() {
        let theirs = picture(&[[1.0; 3], [1.0; 3], [2.0, 1.0, 1.0], [4.0; 3]], None);
        let ours =
            picture(&[[1.1; 3], [0.9; 3], [2.0, 1.5, 1.0], [4.0; 3]], Some(&[0.0, 0.0, 1.0, -1.0]));
        let found = compare(&ours, &theirs, &Options::default()).unwrap();
        let of: Vec<Pixels> = found.rows.iter().map(|r| r.of).collect();
        assert_eq!(of, [Pixels::All, Pixels::Room(0), Pixels::Room(1)]);
        let [all, west, east] = &found.rows[..] else { panic!() };
        assert_eq!((all.pixels, west.pixels, east.pixels), (4, 2, 1));
        assert!((west.ratio() - 1.0).abs() < 1e-6);
        let off = 0.01 / (1.0 + found.epsilon);
        assert!((west.rel_mse - off).abs() < 1e-6, "{} {off}", west.rel_mse);
        assert_eq!(east.ratios(), [1.0, 1.5, 1.0]);
        assert!((found.off() - 0.5).abs() < 1e-9);
        assert!(found.table().contains("relMSE"));

        let only = Options { mask_room: Some(0), ..Options::default() };
        assert_eq!(compare(&ours, &theirs, &only).unwrap().rows[0].pixels, 2);
        let none = Options { mask_room: Some(7), ..Options::default() };
        assert!(compare(&ours, &theirs, &none).is_err());
        // Their picture has no rooms: the other way round there is one row.
        assert_eq!(compare(&theirs, &ours, &Options::default()).unwrap().rows.len(), 1);
        assert!(compare(&theirs, &ours, &only).is_err());
        let layer = Options { layer: Some("direct".into()), ..Options::default() };
        assert!(compare(&ours, &theirs, &layer).unwrap_err().message.contains("direct.R"));
    }

    /// A pixel that is half of a bright room counts as none's: its room by its first sample is off by chance.
    #[test]
    fn pixels_of_several_rooms_are_of_none() {
        let theirs = picture(&[[1.0; 3], [2.5; 3], [4.0; 3]], None);
        let mut ours = picture(&[[1.0; 3], [3.0; 3], [4.0; 3]], Some(&[0.0, 0.0, 1.0]));
        assert_eq!(compare(&ours, &theirs, &Options::default()).unwrap().rows[1].pixels, 2);
        ours.channels.insert("room.mixed".into(), vec![0.0, 1.0, 0.0]);
        let found = compare(&ours, &theirs, &Options::default()).unwrap();
        let [all, dark, bright, several] = &found.rows[..] else { panic!("{found:?}") };
        assert_eq!((all.of, all.pixels), (Pixels::All, 3));
        assert_eq!((dark.pixels, dark.ratio(), bright.pixels, bright.ratio()), (1, 1.0, 1, 1.0));
        assert_eq!((several.of, several.pixels), (Pixels::Mixed, 1));
        assert!((several.ratio() - 1.2).abs() < 1e-6);
        // It is judged among all: 8 of 7.5.
        assert!((found.off() - 0.5 / 7.5).abs() < 1e-6);
        assert!(found.table().contains("several"));
        let only = Options { mask_room: Some(0), ..Options::default() };
        assert_eq!(compare(&ours, &theirs, &only).unwrap().rows[0].pixels, 1);
    }

    #[test]
    fn lamps_and_what_is_no_number_stay_out() {
        let theirs = picture(&[[1.0; 3], [f32::NAN; 3], [1.0; 3]], None);
        let ours = picture(&[[1.0; 3], [1.0; 3], [50.0; 3]], None);
        let options = Options { below: Some(10.0), ..Options::default() };
        let found = compare(&ours, &theirs, &options).unwrap();
        assert_eq!((found.not_finite, found.bright, found.rows[0].pixels), (1, 1, 1));
        assert_eq!(found.off(), 0.0);
        let black = picture(&[[0.0; 3]], None);
        let found = compare(&black, &black, &Options::default()).unwrap();
        assert_eq!((found.off(), found.rows[0].rel_mse), (0.0, 0.0));
    }
}
