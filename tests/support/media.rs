//! The media types of toy kinds: whole numbers, and a page of text.

use tauflow_contract::{Artifact, Context, KindError, Media, ReadFiles, Stored, WriteFiles};

/// A number; blanks after it make its blob long, so that it gets a file of its own in the store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Number {
    /// The number.
    pub value: i64,
    /// How many blanks.
    pub pad: usize,
}

const NUMBER: &str = "number.txt";

impl Number {
    /// A number without blanks.
    pub fn of(value: i64) -> Self {
        Self { value, pad: 0 }
    }

    fn text(self) -> String {
        format!("{}{}", self.value, " ".repeat(self.pad))
    }

    fn parse(bytes: &[u8]) -> Result<Self, KindError> {
        let text = String::from_utf8_lossy(bytes);
        let digits = text.trim();
        let value = digits.parse().map_err(|_| KindError::Input(format!("`{digits}` is not a number; give digits")))?;
        Ok(Self { value, pad: text.len() - text.trim_end_matches(' ').len() })
    }
}

impl Media for Number {
    const NAME: &'static str = "toy/number";
    const DOC: &'static str = "A whole number: `number.txt`.";

    fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        Self::parse(&ctx.part(artifact, "")?)
    }

    fn store(&self, ctx: &Context<'_>) -> Result<Stored<Self>, KindError> {
        Ok(Stored::blob(ctx.put(self.text().as_bytes())?))
    }

    fn export(ctx: &Context<'_>, artifact: &Artifact, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        to.put(NUMBER, Self::load(ctx, artifact)?.text().as_bytes())
    }

    fn import(ctx: &Context<'_>, from: &dyn ReadFiles) -> Result<Stored<Self>, KindError> {
        Self::parse(&from.need(NUMBER)?)?.store(ctx)
    }
}

/// A page of text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Text(pub String);

const PAGE: &str = "page.txt";

impl Media for Text {
    const NAME: &'static str = "toy/text";
    const DOC: &'static str = "A page of text: `page.txt`.";

    fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        Ok(Self(String::from_utf8_lossy(&ctx.part(artifact, PAGE)?).into_owned()))
    }

    fn store(&self, ctx: &Context<'_>) -> Result<Stored<Self>, KindError> {
        Ok(Stored::tree([(PAGE.to_owned(), ctx.put(self.0.as_bytes())?)]))
    }

    fn export(ctx: &Context<'_>, artifact: &Artifact, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        to.put(PAGE, Self::load(ctx, artifact)?.0.as_bytes())
    }

    fn import(ctx: &Context<'_>, from: &dyn ReadFiles) -> Result<Stored<Self>, KindError> {
        Self(String::from_utf8_lossy(&from.need(PAGE)?).into_owned()).store(ctx)
    }
}
