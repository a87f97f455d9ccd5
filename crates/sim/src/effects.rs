//! What may be switched on and off, each by its name.

use crate::SimError;
use std::fmt;
use std::str::FromStr;

macro_rules! effects {
    ($($variant:ident, $name:literal, $usual:literal, $text:literal;)*) => {
        /// One switch.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum Effect {
            $(#[doc = $text] $variant,)*
        }

        impl Effect {
            /// All effects in the order of the chain from tissue to file, then the magnet's.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)*];

            /// Its name on the command line.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }

            /// What it does, in a few words.
            pub const fn text(self) -> &'static str {
                match self { $(Self::$variant => $text,)* }
            }

            /// Whether it belongs to an ordinary recording.
            const fn is_usual(self) -> bool {
                match self { $(Self::$variant => $usual,)* }
            }
        }
    };
}

effects! {
    Peristalsis, "peristalsis", true, "travelling rings of narrowing";
    Breathing, "breathing", true, "the organ swings with the diaphragm";
    Contraction, "contraction", true, "places of the wall tighten and relax";
    Specular, "specular", true, "highlights of the lamps on the wet surface";
    Subsurface, "subsurface", true, "light that travels under the surface softens the shading";
    Shadow, "shadow", false, "folds cast shadows";
    Contact, "contact", false, "the window leans against the wall, which hides the rest";
    Fluid, "fluid", false, "fluid pools at the lowest place";
    Bubbles, "bubbles", false, "foam bubbles in the lumen";
    Debris, "debris", false, "opaque particles in the lumen";
    Defocus, "defocus", true, "the lens blurs what is too near or too far";
    MotionBlur, "motion-blur", true, "the picture smears along its motion during the exposure";
    RollingShutter, "rolling-shutter", false, "rows are read out one after another";
    Droplets, "droplets", false, "drops of water cling to the window";
    Vignette, "vignette", true, "the picture darkens towards its edge";
    Exposure, "exposure", true, "the gain follows the brightness with a delay";
    Noise, "noise", true, "photon and read-out noise of the sensor";
    Gamma, "gamma", true, "the sRGB curve; without it values are proportional to light";
    Chroma, "chroma", true, "colour at half the resolution (4:2:0)";
    Jpeg, "jpeg", true, "JPEG compression";
    Hall, "hall", true, "noise, offsets and steps of the Hall sensors";
    Actuation, "actuation", false, "the steering coils disturb the Hall sensors";
}

/// A set of effects.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Effects(u32);

impl Effects {
    /// Nothing: a rigid organ, matt under point lights, seen by a perfect camera.
    pub const fn none() -> Self {
        Self(0)
    }

    /// Everything there is.
    pub fn all() -> Self {
        Effect::ALL.iter().fold(Self::none(), |set, effect| set.with(*effect))
    }

    /// Whether an effect is in the set.
    pub const fn has(self, effect: Effect) -> bool {
        self.0 & (1 << effect as u32) != 0
    }

    /// The set with one more effect.
    #[must_use]
    pub const fn with(self, effect: Effect) -> Self {
        Self(self.0 | (1 << effect as u32))
    }

    /// The set without an effect.
    #[must_use]
    pub const fn without(self, effect: Effect) -> Self {
        Self(self.0 & !(1 << effect as u32))
    }
}

/// What an ordinary recording shows.
impl Default for Effects {
    fn default() -> Self {
        Effect::ALL.iter().filter(|effect| effect.is_usual()).fold(Self::none(), |set, effect| set.with(*effect))
    }
}

impl fmt::Display for Effects {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> =
            Effect::ALL.iter().filter(|effect| self.has(**effect)).map(|effect| effect.name()).collect();
        formatter.write_str(if names.is_empty() { "none".into() } else { names.join(",") }.as_str())
    }
}

impl fmt::Debug for Effects {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Effects({self})")
    }
}

/// Reads `none`, `default`, `all` and names, each added; `no-NAME` takes one away. `default,fluid,no-noise`.
impl FromStr for Effects {
    type Err = SimError;

    fn from_str(text: &str) -> Result<Self, SimError> {
        let mut set = Self::none();
        for word in text.split(',').map(str::trim) {
            let named = |name: &str| Effect::ALL.iter().find(|effect| effect.name() == name);
            set = match (word, named(word), word.strip_prefix("no-").and_then(named)) {
                ("none", ..) => Self::none(),
                ("default", ..) => Self(set.0 | Self::default().0),
                ("all", ..) => Self::all(),
                (_, Some(effect), _) => set.with(*effect),
                (_, None, Some(effect)) => set.without(*effect),
                (_, None, None) => {
                    let names: Vec<&str> = Effect::ALL.iter().map(|effect| effect.name()).collect();
                    let remedy =
                        format!("use none, default, all, or names of: {}; no-NAME takes one away", names.join(", "));
                    return Err(SimError::parameter(format!("there is no effect `{word}`"), remedy));
                }
            };
        }
        Ok(set)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_read_back() {
        for set in [Effects::none(), Effects::default(), Effects::all()] {
            assert_eq!(set.to_string().parse::<Effects>().unwrap(), set);
        }
        let set: Effects = "default,fluid,no-noise".parse().unwrap();
        assert!(set.has(Effect::Fluid) && !set.has(Effect::Noise) && set.has(Effect::Gamma));
        assert!("glitter".parse::<Effects>().unwrap_err().to_string().contains("`glitter`"));
    }
}
