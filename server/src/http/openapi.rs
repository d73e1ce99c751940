//! The API's description, made from the handlers and checked in as `server/openapi.json`.

use axum::http::{HeaderName, header};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::problem::{Problem, ProblemCode};
use utoipa::openapi::path::{Operation, Parameter};
use utoipa::openapi::schema::{Schema, SchemaType, Type};
use utoipa::openapi::security::{Http, HttpAuthScheme, SecurityScheme};
use utoipa::openapi::{Content, Ref, RefOr, Response, ResponseBuilder};
use utoipa::{Modify, OpenApi, openapi};

use super::problem::PROBLEM_JSON;
use super::{bakes, chunks, enrolments, evaluations, events, health, leases, results};

#[derive(OpenApi)]
#[openapi(
    info(
        title = "Lightkiln",
        description = "Relightable global illumination, baked as a service. Errors are RFC 9457 problems.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0")
    ),
    servers((url = "/")),
    tags(
        (name = "scenes", description = "Scene bundles, named by digest"),
        (name = "bakes", description = "Bakes and what happens to them"),
        (name = "chunks", description = "Stored bytes, named by digest"),
        (name = "workers", description = "Who works on the farm"),
        (name = "leases", description = "For workers: tasks, held for a time"),
        (name = "operation", description = "For those who run the server"),
    ),
    paths(
        chunks::put_scene, chunks::head_scene, chunks::put_scene_together, chunks::put_scene_part, chunks::put_chunk, chunks::get_chunk, chunks::head_chunk,
        bakes::submit, bakes::list, bakes::show, bakes::delete, bakes::blocklist, bakes::clear_blocklist, bakes::cancel, bakes::pause, bakes::resume, bakes::reprioritise,
        bakes::manifest, bakes::report, bakes::workers, events::events, results::results,
        evaluations::show, evaluations::attach, evaluations::file, evaluations::put_file,
        leases::claim, leases::heartbeat, leases::commit, leases::commit_all, leases::fail, leases::release,
        enrolments::enrol,
        health::healthz, health::readyz, health::metrics, show,
    ),
    components(schemas(Digest, Problem)),
    modifiers(&Bearer, &Problems),
    security((), ("bearer" = []))
)]
struct Description;

/// A token in the header Authorization; needed once the farm has one.
struct Bearer;

impl Modify for Bearer {
    fn modify(&self, description: &mut openapi::OpenApi) {
        let scheme = SecurityScheme::Http(Http::new(HttpAuthScheme::Bearer));
        description.components.get_or_insert_default().add_security_scheme("bearer", scheme);
    }
}

/// Says that errors are problems, and names in each call those that no handler speaks of: those of the checks before it,
/// and of the stores behind it. So a status that is not described is a fault.
struct Problems;

impl Modify for Problems {
    fn modify(&self, description: &mut openapi::OpenApi) {
        for (path, item) in &mut description.paths.paths {
            // An answer to HEAD has no body.
            for call in [&mut item.get, &mut item.post, &mut item.put, &mut item.delete].into_iter().flatten()
            {
                call.responses.responses.iter_mut().for_each(error_is_problem);
            }
            let calls = [
                (&mut item.get, false),
                (&mut item.head, false),
                (&mut item.post, true),
                (&mut item.put, true),
                (&mut item.delete, true),
            ];
            for (call, writes) in calls {
                let Some(call) = call else { continue };
                call.parameters.iter_mut().flatten().for_each(absent_is_not_null);
                for code in common_problems(path, call, writes) {
                    let responses = &mut call.responses.responses;
                    let reference = RefOr::Ref(Ref::from_response_name(response_name(code)));
                    responses.entry(code.row().0.to_string()).or_insert(reference);
                }
            }
        }
        let responses = &mut description.components.get_or_insert_default().responses;
        for code in COMMON {
            responses.insert(response_name(code), RefOr::T(problem_response(code)));
        }
    }
}

/// An error without a body of its own has a problem for one.
fn error_is_problem((status, response): (&String, &mut RefOr<Response>)) {
    if let RefOr::T(response) = response
        && status.starts_with(['4', '5'])
    {
        response.content.entry(PROBLEM_JSON.to_owned()).or_insert_with(|| problem_content().into());
    }
}

/// A parameter that need not be there is left out; there is no null in a URL or a header.
fn absent_is_not_null(parameter: &mut RefOr<Parameter>) {
    if let RefOr::T(Parameter { schema: Some(RefOr::T(Schema::Object(object))), .. }) = parameter
        && let SchemaType::Array(types) = &mut object.schema_type
    {
        types.retain(|kind| *kind != Type::Null);
        if let [kind] = types.as_slice() {
            object.schema_type = SchemaType::Type(kind.clone());
        }
    }
}

/// Problems of more than one call, each with a status of its own.
const COMMON: [ProblemCode; 10] = [
    ProblemCode::BadRequest,
    ProblemCode::Unauthorized,
    ProblemCode::Forbidden,
    ProblemCode::NotFound,
    ProblemCode::BrokeOff,
    ProblemCode::TooLarge,
    ProblemCode::TooManyRequests,
    ProblemCode::StorageFull,
    ProblemCode::Unavailable,
    ProblemCode::Internal,
];

/// Those of [`COMMON`] that a call may answer with.
fn common_problems(path: &str, call: &Operation, writes: bool) -> Vec<ProblemCode> {
    use ProblemCode::*;
    let mut codes = match path {
        "/healthz" => return Vec::new(),
        "/readyz" => return vec![Unavailable, StorageFull, Internal],
        "/openapi.json" => return vec![TooManyRequests, Internal],
        _ => vec![Unauthorized, Forbidden, TooManyRequests, Unavailable, Internal],
    };
    if call.parameters.is_some() || call.request_body.is_some() {
        codes.push(BadRequest);
    }
    if call.request_body.is_some() {
        codes.extend([BrokeOff, TooLarge]);
    }
    if path.contains('{') {
        codes.push(NotFound);
    }
    if writes {
        codes.push(StorageFull);
    }
    codes
}

fn response_name(code: ProblemCode) -> String {
    format!("{code:?}")
}

fn problem_content() -> Content {
    Content::new(Some(Ref::from_schema_name("Problem")))
}

fn problem_response(code: ProblemCode) -> Response {
    ResponseBuilder::new().description(code.row().2).content(PROBLEM_JSON, problem_content()).build()
}

/// This description.
#[utoipa::path(get, path = "/openapi.json", tag = "operation", operation_id = "openapi",
    responses((status = 200, description = "OpenAPI description", body = serde_json::Value)))]
pub(super) async fn show() -> ([(HeaderName, &'static str); 1], String) {
    ([(header::CONTENT_TYPE, "application/json")], openapi_json())
}

/// The OpenAPI description as JSON text.
pub fn openapi_json() -> String {
    // The description is built by macros from valid parts.
    Description::openapi().to_pretty_json().unwrap_or_default() + "\n"
}
