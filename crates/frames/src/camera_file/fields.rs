//! YAML, JSON and OpenCV's XML brought to one form: a flat list of named values.
//!
//! Nesting becomes a dotted path (`cam0.intrinsics`), arrays of any depth become one list under the name they belong
//! to. The YAML reader works on parser events, so neither aliases nor deep nesting can make it grow.

use crate::malformed::{Malformed, finite};
use saphyr_parser::{Event, Parser};

/// Deepest nesting of names, longest name and most values a camera file may have; real ones stay far below.
const DEEPEST: usize = 8;
const LONGEST_NAME: usize = 64;
const MOST_VALUES: usize = 10_000;

/// Named values in the order of the file.
#[derive(Debug, Default)]
pub struct Fields {
    fields: Vec<Field>,
    values: usize,
}

#[derive(Debug)]
struct Field {
    path: String,
    values: Vec<String>,
}

impl Field {
    /// The last part of the path; the numbers of an OpenCV matrix (`K.data`) go by the matrix's name.
    fn name(&self) -> &str {
        let path = self.path.strip_suffix(".data").unwrap_or(&self.path);
        path.rsplit('.').next().unwrap_or(path)
    }
}

impl Fields {
    /// Flattens YAML, OpenCV's `%YAML:1.0` dialect included.
    pub fn from_yaml(text: &str) -> Result<Self, Malformed> {
        // Directives are blanked rather than removed to keep line numbers; OpenCV's is not valid YAML.
        let text: String =
            text.lines().map(|line| if line.starts_with('%') { "\n".into() } else { format!("{line}\n") }).collect();
        let mut parser = Parser::new_from_str(&text);
        let mut flattener = Flattener::default();
        while let Some(event) = parser.next_event() {
            let (event, span) = event
                .map_err(|error| Malformed::line(error.marker().line(), format!("is no YAML ({})", error.info())))?;
            if event == Event::DocumentEnd {
                break;
            }
            flattener.take(&event).map_err(|reason| Malformed::line(span.start.line(), reason))?;
        }
        Ok(flattener.fields)
    }

    /// Flattens JSON.
    pub fn from_json(value: &serde_json::Value) -> Result<Self, Malformed> {
        let mut fields = Self::default();
        fields.add_json("", value, 0).map_err(Malformed::whole)?;
        Ok(fields)
    }

    /// Flattens an OpenCV XML storage: every leaf element is a field, its text split at blanks.
    pub fn from_xml(document: &roxmltree::Document<'_>) -> Result<Self, Malformed> {
        let mut fields = Self::default();
        for leaf in document.descendants().filter(|node| node.is_element() && !node.children().any(|n| n.is_element()))
        {
            let mut names: Vec<&str> =
                leaf.ancestors().take(DEEPEST).filter(|n| n.is_element()).map(|n| n.tag_name().name()).collect();
            names.reverse();
            let path = names.join(".");
            for value in leaf.text().unwrap_or("").split_whitespace() {
                fields.push(&path, value).map_err(Malformed::whole)?;
            }
        }
        Ok(fields)
    }

    fn add_json(&mut self, path: &str, value: &serde_json::Value, depth: usize) -> Result<(), String> {
        use serde_json::Value;
        check_depth(depth)?;
        match value {
            Value::Null => Ok(()),
            Value::Array(items) => items.iter().try_for_each(|item| self.add_json(path, item, depth + 1)),
            Value::Object(map) => {
                map.iter().try_for_each(|(name, value)| self.add_json(&joined(path, name)?, value, depth + 1))
            }
            Value::String(text) => self.push(path, text),
            Value::Bool(_) | Value::Number(_) => self.push(path, &value.to_string()),
        }
    }

    /// Appends a value to the field of this path, which is the last one or new.
    fn push(&mut self, path: &str, value: &str) -> Result<(), String> {
        self.values += 1;
        if self.values > MOST_VALUES {
            return Err(format!("holds more than {MOST_VALUES} values, which no camera file does"));
        }
        match self.fields.last_mut() {
            Some(field) if field.path == path => field.values.push(value.to_owned()),
            _ => self.fields.push(Field { path: path.to_owned(), values: vec![value.to_owned()] }),
        }
        Ok(())
    }

    /// The first field with one of these names, the earlier name preferred.
    fn find(&self, names: &[&str]) -> Option<&Field> {
        let named = |name: &str| self.fields.iter().find(|field| field.name() == name);
        names.iter().find_map(|name| named(name))
    }

    /// The first value of the first such field, as text.
    pub fn text(&self, names: &[&str]) -> Option<&str> {
        self.find(names)?.values.first().map(String::as_str)
    }

    /// All values of the first such field, as finite numbers; values that hold several are split at blanks.
    pub fn numbers(&self, names: &[&str]) -> Result<Option<Vec<f64>>, Malformed> {
        let Some(field) = self.find(names) else { return Ok(None) };
        let words = field.values.iter().flat_map(|value| value.split_whitespace());
        let numbers: Result<Vec<f64>, String> = words.map(|word| finite(word, &field.path)).collect();
        numbers.map(Some).map_err(Malformed::whole)
    }

    /// The first value of the first such field, as a finite number.
    pub fn number(&self, names: &[&str]) -> Result<Option<f64>, Malformed> {
        let Some(text) = self.text(names) else { return Ok(None) };
        finite(text, names[0]).map(Some).map_err(Malformed::whole)
    }
}

/// Parses XML, with the line of the first fault.
pub fn xml(text: &str) -> Result<roxmltree::Document<'_>, Malformed> {
    roxmltree::Document::parse(text)
        .map_err(|error| Malformed::line(error.pos().row as usize, format!("is no XML ({error})")))
}

fn check_depth(depth: usize) -> Result<(), String> {
    if depth > DEEPEST {
        Err(format!("is nested deeper than {DEEPEST} levels, which no camera file is"))
    } else {
        Ok(())
    }
}

fn joined(path: &str, name: &str) -> Result<String, String> {
    if name.len() > LONGEST_NAME {
        return Err(format!("holds a name of {} characters, which no camera file does", name.len()));
    }
    Ok(if path.is_empty() { name.to_owned() } else { format!("{path}.{name}") })
}

/// Where in the nesting the YAML events are.
#[derive(Default)]
struct Flattener {
    fields: Fields,
    open: Vec<Open>,
}

enum Open {
    /// A mapping; the path of the value awaited, `None` while a key is.
    Mapping { path: String, awaited: Option<String> },
    /// A sequence, whose items all go to the path.
    Sequence { path: String },
}

impl Flattener {
    fn take(&mut self, event: &Event<'_>) -> Result<(), String> {
        match event {
            Event::MappingStart(..) => {
                let path = self.value_path()?;
                self.open(Open::Mapping { path, awaited: None })
            }
            Event::SequenceStart(..) => {
                let path = self.value_path()?;
                self.open(Open::Sequence { path })
            }
            Event::MappingEnd | Event::SequenceEnd => {
                self.open.pop();
                Ok(())
            }
            Event::Scalar(text, ..) => self.scalar(text),
            Event::Alias(_) => Err("uses a YAML alias, which camera files do not".into()),
            _ => Ok(()),
        }
    }

    fn open(&mut self, level: Open) -> Result<(), String> {
        check_depth(self.open.len())?;
        self.open.push(level);
        Ok(())
    }

    /// Path of the value that comes now.
    fn value_path(&mut self) -> Result<String, String> {
        match self.open.last_mut() {
            None => Ok(String::new()),
            Some(Open::Sequence { path }) => Ok(path.clone()),
            Some(Open::Mapping { awaited, .. }) => {
                awaited.take().ok_or_else(|| "has a list or mapping where a name was expected".into())
            }
        }
    }

    fn scalar(&mut self, text: &str) -> Result<(), String> {
        if let Some(Open::Mapping { path, awaited: awaited @ None }) = self.open.last_mut() {
            *awaited = Some(joined(path, text)?);
            return Ok(());
        }
        let path = self.value_path()?;
        self.fields.push(&path, text)
    }
}
