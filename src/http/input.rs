//! Bodies, queries and path segments as calls want them, and errors as CTL-2 wants them.

use std::collections::HashSet;
use std::fmt::{self, Formatter};
use std::time::Duration;

use axum::body::{Bytes, to_bytes};
use axum::extract::rejection::{PathRejection, QueryRejection};
use axum::extract::{FromRequest, FromRequestParts, Request};
use axum::http::request::Parts;
use axum::middleware::Next;
use axum::response::Response;
use serde::de::{DeserializeOwned, Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::Value;

use super::error::ApiError;

/// Most bytes of a body (CTL-2).
const BODY_MAX: usize = 1 << 20;

/// How long a body may take to come.
const BODY_WITHIN: Duration = Duration::from_secs(10);

/// A JSON body.
#[derive(Debug)]
pub struct Body<T>(pub T);

impl<S: Sync, T: DeserializeOwned> FromRequest<S> for Body<T> {
    type Rejection = ApiError;

    async fn from_request(request: Request, _: &S) -> Result<Self, ApiError> {
        let bytes = whole(request.into_body()).await?;
        parse(&bytes).map(Body)
    }
}

/// Waits for the body of any call, so that its limits hold for calls too that have no use for one.
pub async fn await_body(request: Request, next: Next) -> Result<Response, ApiError> {
    let (parts, body) = request.into_parts();
    let bytes = whole(body).await?;
    Ok(next.run(Request::from_parts(parts, bytes.into())).await)
}

async fn whole(body: axum::body::Body) -> Result<Bytes, ApiError> {
    let bytes = tokio::time::timeout(BODY_WITHIN, to_bytes(body, BODY_MAX));
    bytes.await.map_err(|_| ApiError::slow())?.map_err(|error| {
        // Besides its limit, a body fails only with its connection, and then nobody reads this.
        tracing::debug!("a body was not taken: {error}");
        ApiError::too_large()
    })
}

/// Values by name, each name once.
#[derive(Debug)]
pub struct Named(pub Vec<(String, Value)>);

impl<'de> Deserialize<'de> for Named {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_map(NamedVisitor)
    }
}

struct NamedVisitor;

impl<'de> Visitor<'de> for NamedVisitor {
    type Value = Named;

    fn expecting(&self, text: &mut Formatter) -> fmt::Result {
        text.write_str("values by name")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Named, A::Error> {
        let (mut values, mut seen) = (Vec::new(), HashSet::new());
        while let Some((name, value)) = map.next_entry::<String, Value>()? {
            if !seen.insert(name.clone()) {
                return Err(A::Error::custom(format!("duplicate field `{name}`")));
            }
            values.push((name, value));
        }
        Ok(Named(values))
    }
}

fn parse<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, ApiError> {
    let not_json = |error| ApiError::unreadable(format!("the body is not JSON: {error}"));
    let value: Value = serde_json::from_slice(bytes).map_err(not_json)?;
    if !value.is_object() {
        return Err(ApiError::value("the body takes an object, {…}"));
    }
    // Once more from the text, which still has what comes twice.
    let json = &mut serde_json::Deserializer::from_slice(bytes);
    serde_path_to_error::deserialize(json).map_err(|error| {
        let path = error.path().to_string();
        judged(&path, &error.into_inner().to_string())
    })
}

/// The error of a value that is not what its field takes; `message` is serde's.
fn judged(path: &str, message: &str) -> ApiError {
    let told = |what: &str| message.strip_prefix(what).and_then(|rest| rest.split('`').next());
    let unknown = told("unknown field `");
    let other = told("missing field `").or_else(|| told("duplicate field `"));
    // Where in the text it stands helps nobody who has written it with a library.
    let message = message.split(" at line ").next().unwrap_or(message);
    match (unknown, other, path) {
        (Some(field), ..) => ApiError::unknown_field(field, message),
        (None, Some(field), _) => ApiError::value(message).of(field),
        (None, None, "." | "") => ApiError::value(message),
        (None, None, path) => ApiError::value(format!("{path}: {message}")).of(path),
    }
}

/// A query string.
#[derive(Debug)]
pub struct Query<T>(pub T);

impl<S: Send + Sync, T: DeserializeOwned> FromRequestParts<S> for Query<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        match axum::extract::Query::<T>::from_request_parts(parts, state).await {
            Ok(axum::extract::Query(query)) => Ok(Self(query)),
            Err(rejection) => Err(bad_query(&rejection)),
        }
    }
}

fn bad_query(rejection: &QueryRejection) -> ApiError {
    let text = rejection.body_text();
    let message = text.strip_prefix("Failed to deserialize query string: ").unwrap_or(&text);
    let (path, message) = message.split_once(": ").unwrap_or((".", message));
    judged(path, message)
}

/// A path segment.
#[derive(Debug)]
pub struct Segment<T>(pub T);

impl<S: Send + Sync, T: DeserializeOwned + Send> FromRequestParts<S> for Segment<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        match axum::extract::Path::<T>::from_request_parts(parts, state).await {
            Ok(axum::extract::Path(segment)) => Ok(Self(segment)),
            Err(rejection) => Err(bad_segment(&rejection)),
        }
    }
}

fn bad_segment(rejection: &PathRejection) -> ApiError {
    ApiError::not_found(format!("there is nothing of that name: {}", rejection.body_text()))
}
