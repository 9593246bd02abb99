// A small middleware for real nodes of ROS 2 Jazzy: rclpy and rcl above, Cyclone DDS below.
//
// It stands in for rmw_cyclonedds, which no package index has. It is written against the headers
// of ROS 2's wheels and does what matters to security as that does: the participant is made with
// the first node and goes with the last; the files are found by ROS 2's own rmw_dds_common, and
// given as QoS properties; the plugins are named dds_security_*, for the loader to find; there are
// readers of the builtin topics, and ros_discovery_info both ways. What it does not do: the graph,
// events, loans, and types on the wire that other ROS 2 nodes would understand.
//
// It is preloaded, so that its functions are found before those of the wheels' rmw_fastrtps_cpp.

#include <algorithm>
#include <cstring>
#include <string>
#include <unordered_map>
#include <vector>

#include "dds/dds.h"
#include "fastcdr/Cdr.h"
#include "rcutils/strdup.h"
#include "rmw/discovery_options.h"
#include "rmw/error_handling.h"
#include "rmw/event.h"
#include "rmw/features.h"
#include "rmw/rmw.h"
#include "rmw_dds_common/security.hpp"
#include "rosidl_typesupport_fastrtps_c/identifier.h"
#include "rosidl_typesupport_fastrtps_cpp/message_type_support.h"
#include "rosidl_typesupport_fastrtps_cpp/service_type_support.h"

#include "Frame.h"

using eprosima::fastcdr::Cdr;
using eprosima::fastcdr::CdrVersion;
using eprosima::fastcdr::FastBuffer;
using Type = const message_type_support_callbacks_t*;

namespace {

constexpr const char* NAME = "rmw_cyclonedds_cpp";
constexpr size_t GUID_PREFIX = 12;  // octets, the same for all entities of one participant
constexpr size_t MANY = 64;         // more readers of one service's answers than a test has

// ---- What stands behind the structures of ROS 2

struct Endpoint {  // of a publisher, subscription, service or client
    dds_entity_t writer = 0, reader = 0, arrived = 0;
    Type written = nullptr, read = nullptr;
    rmw_qos_profile_t qos{};
    int64_t number = 0;
    std::string name;

    ~Endpoint() {
        for (dds_entity_t entity : {writer, reader})
            if (entity > 0) dds_delete(entity);
    }
};

struct Node {
    std::string name, space;
    rmw_guard_condition_t* graph;
};

}  // namespace

struct rmw_context_impl_s {
    dds_entity_t participant = 0;
    int nodes = 0;
};

namespace {

template <typename Structure>
Endpoint& endpoint_of(const Structure* structure) {
    return *static_cast<Endpoint*>(structure->data);
}

template <typename Structure>
rmw_ret_t destroy(Structure* structure) {
    delete &endpoint_of(structure);
    delete structure;
    return RMW_RET_OK;
}

// ---- Participants

constexpr std::pair<const char*, const char*> FILES[] = {
    {"dds.sec.auth.identity_ca", "IDENTITY_CA"},
    {"dds.sec.auth.identity_certificate", "CERTIFICATE"},
    {"dds.sec.auth.private_key", "PRIVATE_KEY"},
    {"dds.sec.access.permissions_ca", "PERMISSIONS_CA"},
    {"dds.sec.access.governance", "GOVERNANCE"},
    {"dds.sec.access.permissions", "PERMISSIONS"},
    {"org.eclipse.cyclonedds.sec.auth.crl", "CRL"},
};

constexpr std::pair<const char*, const char*> PLUGINS[] = {
    {"dds.sec.auth.library.path", "dds_security_auth"},
    {"dds.sec.auth.library.init", "init_authentication"},
    {"dds.sec.auth.library.finalize", "finalize_authentication"},
    {"dds.sec.crypto.library.path", "dds_security_crypto"},
    {"dds.sec.crypto.library.init", "init_crypto"},
    {"dds.sec.crypto.library.finalize", "finalize_crypto"},
    {"dds.sec.access.library.path", "dds_security_ac"},
    {"dds.sec.access.library.init", "init_access_control"},
    {"dds.sec.access.library.finalize", "finalize_access_control"},
};

bool secure(dds_qos_t* qos, const rmw_security_options_t& options) {
    if (!options.security_root_path) return true;
    std::unordered_map<std::string, std::string> files;
    if (!rmw_dds_common::get_security_files("file:", options.security_root_path, files)) {
        RCUTILS_SAFE_FWRITE_TO_STDERR("could not find all security files\n");
        return options.enforce_security != RMW_SECURITY_ENFORCEMENT_ENFORCE;
    }
    for (auto [property, file] : FILES)
        if (files.count(file)) dds_qset_prop(qos, property, files[file].c_str());
    for (auto [property, value] : PLUGINS) dds_qset_prop(qos, property, value);
    return true;
}

dds_entity_t topic(dds_entity_t participant, const std::string& name) {
    dds_entity_t made =
        dds_create_topic(participant, &pqsec_Frame_desc, name.c_str(), nullptr, nullptr);
    if (made < 0)
        RMW_SET_ERROR_MSG_WITH_FORMAT_STRING(
            "failed to create topic [%s] for unknown reasons", name.c_str());
    return made;
}

bool discover(dds_entity_t participant) {  // what rmw_cyclonedds has, though nobody reads it here
    for (dds_entity_t builtin : {DDS_BUILTIN_TOPIC_DCPSPARTICIPANT,
                                 DDS_BUILTIN_TOPIC_DCPSSUBSCRIPTION,
                                 DDS_BUILTIN_TOPIC_DCPSPUBLICATION})
        if (dds_create_reader(participant, builtin, nullptr, nullptr) < 0) {
            RMW_SET_ERROR_MSG("failed to create reader of a builtin topic");
            return false;
        }
    dds_entity_t info = topic(participant, "ros_discovery_info");
    if (info < 0) return false;
    const char* refused = dds_create_writer(participant, info, nullptr, nullptr) < 0   ? "writer"
                          : dds_create_reader(participant, info, nullptr, nullptr) < 0 ? "reader"
                                                                                       : nullptr;
    if (refused) RMW_SET_ERROR_MSG_WITH_FORMAT_STRING("failed to create %s", refused);
    return !refused;
}

bool join(rmw_context_t& context) {
    dds_qos_t* qos = dds_create_qos();
    dds_entity_t made = secure(qos, context.options.security_options)
                            ? dds_create_participant(context.actual_domain_id, qos, nullptr)
                            : DDS_RETCODE_ERROR;
    dds_delete_qos(qos);
    if (made < 0) {
        RMW_SET_ERROR_MSG("rmw_create_node: failed to create DDS participant");
        return false;
    }
    if (!discover(made)) {
        dds_delete(made);
        return false;
    }
    context.impl->participant = made;
    return true;
}

// ---- Messages

Type type_of(const rosidl_message_type_support_t* support) {
    const auto* found =
        get_message_typesupport_handle(support, rosidl_typesupport_fastrtps_c__identifier);
    return found ? static_cast<Type>(found->data) : nullptr;
}

const service_type_support_callbacks_t* type_of(const rosidl_service_type_support_t* support) {
    const auto* found =
        get_service_typesupport_handle(support, rosidl_typesupport_fastrtps_c__identifier);
    return found ? static_cast<const service_type_support_callbacks_t*>(found->data) : nullptr;
}

rmw_ret_t write(const Endpoint& endpoint, const void* message, const rmw_request_id_t& id) {
    std::vector<char> bytes(endpoint.written->get_serialized_size(message) + 16);
    FastBuffer buffer(bytes.data(), bytes.size());
    Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, CdrVersion::XCDRv1);
    if (!endpoint.written->cdr_serialize(message, cdr)) return RMW_RET_ERROR;
    pqsec_Frame frame{};
    memcpy(frame.asker, id.writer_guid, sizeof frame.asker);
    frame.number = id.sequence_number;
    frame.message._buffer = reinterpret_cast<uint8_t*>(bytes.data());
    frame.message._length = frame.message._maximum = cdr.get_serialized_data_length();
    return dds_write(endpoint.writer, &frame) == DDS_RETCODE_OK ? RMW_RET_OK : RMW_RET_ERROR;
}

// One message that is for `only`, if that is named; whether there was one.
bool take(const Endpoint& endpoint, void* message, rmw_request_id_t& id,
          const dds_guid_t* only = nullptr) {
    for (;;) {
        void* sample = nullptr;
        dds_sample_info_t info;
        if (dds_take(endpoint.reader, &sample, &info, 1, 1) != 1) return false;
        auto* frame = static_cast<pqsec_Frame*>(sample);
        bool mine = info.valid_data && (!only || !memcmp(only->v, frame->asker, sizeof only->v));
        if (mine) {
            memcpy(id.writer_guid, frame->asker, sizeof frame->asker);
            id.sequence_number = frame->number;
            FastBuffer buffer(reinterpret_cast<char*>(frame->message._buffer),
                              frame->message._length);
            Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, CdrVersion::XCDRv1);
            mine = endpoint.read->cdr_deserialize(cdr, message);
        }
        dds_return_loan(endpoint.reader, &sample, 1);
        if (mine) return true;
    }
}

// ---- Endpoints

dds_qos_t* qos_of(const rmw_qos_profile_t& profile) {
    dds_qos_t* qos = dds_create_qos();
    bool best_effort = profile.reliability == RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT;
    bool keeps = profile.durability == RMW_QOS_POLICY_DURABILITY_TRANSIENT_LOCAL;
    dds_qset_reliability(
        qos, best_effort ? DDS_RELIABILITY_BEST_EFFORT : DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
    dds_qset_durability(qos, keeps ? DDS_DURABILITY_TRANSIENT_LOCAL : DDS_DURABILITY_VOLATILE);
    if (profile.history == RMW_QOS_POLICY_HISTORY_KEEP_ALL)
        dds_qset_history(qos, DDS_HISTORY_KEEP_ALL, DDS_LENGTH_UNLIMITED);
    else
        dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, std::max<int>(1, profile.depth));
    return qos;
}

// An endpoint that writes and reads what is named; null, with the error set, if it may not.
Endpoint* endpoint(const rmw_node_t* node, const char* name, const rmw_qos_profile_t& profile,
                   const std::string& written, const std::string& read) {
    dds_entity_t participant = node->context->impl->participant;
    dds_qos_t* qos = qos_of(profile);
    auto* made = new Endpoint;
    made->qos = profile;
    made->name = name;
    bool good = true;
    if (!written.empty()) {
        dds_entity_t there = topic(participant, written);
        good = there > 0 &&
               (made->writer = dds_create_writer(participant, there, qos, nullptr)) > 0;
    }
    if (good && !read.empty()) {
        dds_entity_t there = topic(participant, read);
        good = there > 0 &&
               (made->reader = dds_create_reader(participant, there, qos, nullptr)) > 0;
        if (good) made->arrived = dds_create_readcondition(made->reader, DDS_ANY_STATE);
    }
    dds_delete_qos(qos);
    if (good) return made;
    if (!rmw_error_is_set()) RMW_SET_ERROR_MSG("failed to create an endpoint");
    delete made;
    return nullptr;
}

std::string dds_name(const char* prefix, const char* name, const rmw_qos_profile_t& profile,
                     const char* suffix = "") {
    return (profile.avoid_ros_namespace_conventions ? "" : prefix) + std::string(name) + suffix;
}

bool is_matched(const Endpoint& endpoint) {
    dds_publication_matched_status_t out{};
    dds_subscription_matched_status_t in{};
    dds_get_publication_matched_status(endpoint.writer, &out);
    dds_get_subscription_matched_status(endpoint.reader, &in);
    return out.current_count && in.current_count;
}

// Whether a reader of who sent that request is matched with the writer of the endpoint's answers.
bool is_matched_with(const Endpoint& endpoint, const rmw_request_id_t& id) {
    dds_instance_handle_t readers[MANY];
    dds_return_t count = dds_get_matched_subscriptions(endpoint.writer, readers, MANY);
    return std::any_of(readers, readers + std::clamp<int>(count, 0, MANY), [&](auto reader) {
        auto* found = dds_get_matched_subscription_data(endpoint.writer, reader);
        bool is_of_asker = found && !memcmp(found->key.v, id.writer_guid, GUID_PREFIX);
        if (found) dds_builtintopic_free_endpoint(found);
        return is_of_asker;
    });
}

// ---- Waiting

dds_entity_t arrived(void* endpoint) { return static_cast<Endpoint*>(endpoint)->arrived; }

dds_entity_t guard(void* condition) { return *static_cast<dds_entity_t*>(condition); }

void attach(dds_entity_t set, void** things, size_t count, dds_entity_t (*entity)(void*)) {
    for (size_t i = 0; i < count; ++i)
        if (things[i]) dds_waitset_attach(set, entity(things[i]), 0);
}

// What did not happen is null afterwards; returns how much did.
int detach(dds_entity_t set, void** things, size_t count, dds_entity_t (*entity)(void*)) {
    int happened = 0;
    for (size_t i = 0; i < count; ++i) {
        if (!things[i]) continue;
        dds_waitset_detach(set, entity(things[i]));
        bool is_triggered = false;
        if (entity == guard)
            dds_take_guardcondition(guard(things[i]), &is_triggered);
        else
            is_triggered = dds_triggered(entity(things[i])) > 0;
        if (is_triggered)
            ++happened;
        else
            things[i] = nullptr;
    }
    return happened;
}

}  // namespace

// ---- The functions that rcl and rclpy call; rmw.h says what each is to do

extern "C" {

const char* rmw_get_implementation_identifier() { return NAME; }
bool rmw_feature_supported(rmw_feature_t) { return false; }

rmw_ret_t rmw_init_options_init(rmw_init_options_t* options, rcutils_allocator_t allocator) {
    *options = rmw_get_zero_initialized_init_options();
    options->implementation_identifier = NAME;
    options->allocator = allocator;
    options->domain_id = RMW_DEFAULT_DOMAIN_ID;
    options->security_options = rmw_get_default_security_options();
    return rmw_discovery_options_init(&options->discovery_options, 0, &allocator);
}

rmw_ret_t rmw_init_options_copy(const rmw_init_options_t* from, rmw_init_options_t* to) {
    rcutils_allocator_t allocator = from->allocator;
    *to = *from;
    to->enclave = from->enclave ? rcutils_strdup(from->enclave, allocator) : nullptr;
    to->security_options = rmw_get_zero_initialized_security_options();
    to->discovery_options = rmw_get_zero_initialized_discovery_options();
    rmw_ret_t done =
        rmw_security_options_copy(&from->security_options, &allocator, &to->security_options);
    if (done != RMW_RET_OK) return done;
    return rmw_discovery_options_copy(
        &from->discovery_options, &allocator, &to->discovery_options);
}

rmw_ret_t rmw_init_options_fini(rmw_init_options_t* options) {
    rcutils_allocator_t allocator = options->allocator;
    allocator.deallocate(options->enclave, allocator.state);
    rmw_security_options_fini(&options->security_options, &allocator);
    rmw_ret_t done = rmw_discovery_options_fini(&options->discovery_options);
    *options = rmw_get_zero_initialized_init_options();
    return done;
}

rmw_ret_t rmw_init(const rmw_init_options_t* options, rmw_context_t* context) {
    context->instance_id = options->instance_id;
    context->implementation_identifier = NAME;
    bool is_default = options->domain_id == RMW_DEFAULT_DOMAIN_ID;
    context->actual_domain_id = is_default ? 0 : options->domain_id;
    context->impl = new rmw_context_impl_s;
    return rmw_init_options_copy(options, &context->options);
}

rmw_ret_t rmw_shutdown(rmw_context_t*) { return RMW_RET_OK; }

rmw_ret_t rmw_context_fini(rmw_context_t* context) {
    delete context->impl;
    rmw_ret_t done = rmw_init_options_fini(&context->options);
    *context = rmw_get_zero_initialized_context();
    return done;
}

rmw_node_t* rmw_create_node(rmw_context_t* context, const char* name, const char* space) {
    if (!context->impl->participant && !join(*context)) return nullptr;
    ++context->impl->nodes;
    auto* data = new Node{name, space, rmw_create_guard_condition(context)};
    return new rmw_node_t{NAME, data, data->name.c_str(), data->space.c_str(), context};
}

rmw_ret_t rmw_destroy_node(rmw_node_t* node) {
    auto* data = static_cast<Node*>(node->data);
    rmw_ret_t done = rmw_destroy_guard_condition(data->graph);
    rmw_context_impl_s& context = *node->context->impl;
    if (--context.nodes == 0) {
        dds_delete(context.participant);
        context.participant = 0;
    }
    delete data;
    delete node;
    return done;
}

const rmw_guard_condition_t* rmw_node_get_graph_guard_condition(const rmw_node_t* node) {
    return static_cast<Node*>(node->data)->graph;
}

rmw_guard_condition_t* rmw_create_guard_condition(rmw_context_t* context) {
    auto* made = new dds_entity_t(dds_create_guardcondition(DDS_CYCLONEDDS_HANDLE));
    return new rmw_guard_condition_t{NAME, made, context};
}

rmw_ret_t rmw_destroy_guard_condition(rmw_guard_condition_t* condition) {
    auto* made = static_cast<dds_entity_t*>(condition->data);
    dds_delete(*made);
    delete made;
    delete condition;
    return RMW_RET_OK;
}

rmw_ret_t rmw_trigger_guard_condition(const rmw_guard_condition_t* condition) {
    return dds_set_guardcondition(guard(condition->data), true) ? RMW_RET_ERROR : RMW_RET_OK;
}

rmw_wait_set_t* rmw_create_wait_set(rmw_context_t*, size_t) {
    auto* made = new dds_entity_t(dds_create_waitset(DDS_CYCLONEDDS_HANDLE));
    return new rmw_wait_set_t{NAME, nullptr, made};
}

rmw_ret_t rmw_destroy_wait_set(rmw_wait_set_t* set) {
    auto* made = static_cast<dds_entity_t*>(set->data);
    dds_delete(*made);
    delete made;
    delete set;
    return RMW_RET_OK;
}

rmw_ret_t rmw_wait(rmw_subscriptions_t* subscriptions, rmw_guard_conditions_t* guards,
                   rmw_services_t* services, rmw_clients_t* clients, rmw_events_t* events,
                   rmw_wait_set_t* wait_set, const rmw_time_t* timeout) {
    dds_entity_t set = guard(wait_set->data);
    struct Things {
        void** first;
        size_t count;
        dds_entity_t (*entity)(void*);
    };
    std::vector<Things> all;
    if (subscriptions)
        all.push_back({subscriptions->subscribers, subscriptions->subscriber_count, arrived});
    if (services) all.push_back({services->services, services->service_count, arrived});
    if (clients) all.push_back({clients->clients, clients->client_count, arrived});
    if (guards) all.push_back({guards->guard_conditions, guards->guard_condition_count, guard});
    for (auto& each : all) attach(set, each.first, each.count, each.entity);
    dds_duration_t patience = timeout ? DDS_SECS(timeout->sec) + timeout->nsec : DDS_INFINITY;
    dds_waitset_wait(set, nullptr, 0, patience);
    int happened = 0;
    for (auto& each : all) happened += detach(set, each.first, each.count, each.entity);
    if (events) std::fill_n(events->events, events->event_count, nullptr);
    return happened ? RMW_RET_OK : RMW_RET_TIMEOUT;
}

// ---- Topics

rmw_publisher_t* rmw_create_publisher(const rmw_node_t* node,
                                      const rosidl_message_type_support_t* support,
                                      const char* name, const rmw_qos_profile_t* qos,
                                      const rmw_publisher_options_t* options) {
    Endpoint* made = endpoint(node, name, *qos, dds_name("rt", name, *qos), "");
    if (!made) return nullptr;
    made->written = type_of(support);
    return new rmw_publisher_t{NAME, made, made->name.c_str(), *options, false};
}

rmw_ret_t rmw_publish(const rmw_publisher_t* publisher, const void* message,
                      rmw_publisher_allocation_t*) {
    return write(endpoint_of(publisher), message, rmw_request_id_t{});
}

rmw_ret_t rmw_publisher_count_matched_subscriptions(const rmw_publisher_t* publisher,
                                                    size_t* count) {
    dds_publication_matched_status_t status{};
    dds_get_publication_matched_status(endpoint_of(publisher).writer, &status);
    *count = status.current_count;
    return RMW_RET_OK;
}

rmw_subscription_t* rmw_create_subscription(const rmw_node_t* node,
                                            const rosidl_message_type_support_t* support,
                                            const char* name, const rmw_qos_profile_t* qos,
                                            const rmw_subscription_options_t* options) {
    Endpoint* made = endpoint(node, name, *qos, "", dds_name("rt", name, *qos));
    if (!made) return nullptr;
    made->read = type_of(support);
    return new rmw_subscription_t{NAME, made, made->name.c_str(), *options, false, false};
}

rmw_ret_t rmw_take_with_info(const rmw_subscription_t* subscription, void* message, bool* taken,
                             rmw_message_info_t* info, rmw_subscription_allocation_t*) {
    rmw_request_id_t unused;
    *info = rmw_get_zero_initialized_message_info();
    *taken = take(endpoint_of(subscription), message, unused);
    return RMW_RET_OK;
}

rmw_ret_t rmw_subscription_count_matched_publishers(const rmw_subscription_t* subscription,
                                                    size_t* count) {
    dds_subscription_matched_status_t status{};
    dds_get_subscription_matched_status(endpoint_of(subscription).reader, &status);
    *count = status.current_count;
    return RMW_RET_OK;
}

// ---- Services

rmw_service_t* rmw_create_service(const rmw_node_t* node,
                                  const rosidl_service_type_support_t* support, const char* name,
                                  const rmw_qos_profile_t* qos) {
    Endpoint* made = endpoint(node, name, *qos, dds_name("rr", name, *qos, "Reply"),
                              dds_name("rq", name, *qos, "Request"));
    if (!made) return nullptr;
    const auto* type = type_of(support);
    made->written = type_of(type->response_members_);
    made->read = type_of(type->request_members_);
    return new rmw_service_t{NAME, made, made->name.c_str()};
}

rmw_ret_t rmw_take_request(const rmw_service_t* service, rmw_service_info_t* header,
                           void* request, bool* taken) {
    *header = rmw_service_info_t{};
    *taken = take(endpoint_of(service), request, header->request_id);
    return RMW_RET_OK;
}

rmw_ret_t rmw_send_response(const rmw_service_t* service, rmw_request_id_t* header,
                            void* response) {
    // The request may arrive before the client's reader is discovered, and an answer that is
    // written then is lost. rmw_cyclonedds waits too.
    dds_time_t end = dds_time() + DDS_SECS(10);
    while (!is_matched_with(endpoint_of(service), *header) && dds_time() < end)
        dds_sleepfor(DDS_MSECS(10));
    return write(endpoint_of(service), response, *header);
}

rmw_client_t* rmw_create_client(const rmw_node_t* node,
                                const rosidl_service_type_support_t* support, const char* name,
                                const rmw_qos_profile_t* qos) {
    Endpoint* made = endpoint(node, name, *qos, dds_name("rq", name, *qos, "Request"),
                              dds_name("rr", name, *qos, "Reply"));
    if (!made) return nullptr;
    const auto* type = type_of(support);
    made->written = type_of(type->request_members_);
    made->read = type_of(type->response_members_);
    return new rmw_client_t{NAME, made, made->name.c_str()};
}

rmw_ret_t rmw_send_request(const rmw_client_t* client, const void* request, int64_t* number) {
    Endpoint& endpoint = endpoint_of(client);
    dds_guid_t own;
    dds_get_guid(endpoint.writer, &own);
    rmw_request_id_t id{};
    memcpy(id.writer_guid, own.v, sizeof own.v);
    *number = id.sequence_number = ++endpoint.number;
    return write(endpoint, request, id);
}

rmw_ret_t rmw_take_response(const rmw_client_t* client, rmw_service_info_t* header,
                            void* response, bool* taken) {
    dds_guid_t own;
    dds_get_guid(endpoint_of(client).writer, &own);
    *header = rmw_service_info_t{};
    *taken = take(endpoint_of(client), response, header->request_id, &own);
    return RMW_RET_OK;
}

rmw_ret_t rmw_service_server_is_available(const rmw_node_t*, const rmw_client_t* client,
                                          bool* is_available) {
    *is_available = is_matched(endpoint_of(client));
    return RMW_RET_OK;
}

rmw_ret_t rmw_destroy_publisher(rmw_node_t*, rmw_publisher_t* it) { return destroy(it); }
rmw_ret_t rmw_destroy_subscription(rmw_node_t*, rmw_subscription_t* it) { return destroy(it); }
rmw_ret_t rmw_destroy_service(rmw_node_t*, rmw_service_t* it) { return destroy(it); }
rmw_ret_t rmw_destroy_client(rmw_node_t*, rmw_client_t* it) { return destroy(it); }

// ---- What is asked of every endpoint

#define ACTUAL_QOS(function, structure)                                          \
    rmw_ret_t function(const structure* endpoint, rmw_qos_profile_t* qos) { \
        *qos = endpoint_of(endpoint).qos;                                        \
        return RMW_RET_OK;                                                       \
    }
ACTUAL_QOS(rmw_publisher_get_actual_qos, rmw_publisher_t)
ACTUAL_QOS(rmw_subscription_get_actual_qos, rmw_subscription_t)
ACTUAL_QOS(rmw_service_request_subscription_get_actual_qos, rmw_service_t)
ACTUAL_QOS(rmw_service_response_publisher_get_actual_qos, rmw_service_t)
ACTUAL_QOS(rmw_client_request_publisher_get_actual_qos, rmw_client_t)
ACTUAL_QOS(rmw_client_response_subscription_get_actual_qos, rmw_client_t)

rmw_ret_t rmw_publisher_event_init(rmw_event_t*, const rmw_publisher_t*, rmw_event_type_t) {
    RMW_SET_ERROR_MSG("no events here");
    return RMW_RET_UNSUPPORTED;
}

rmw_ret_t rmw_subscription_event_init(rmw_event_t*, const rmw_subscription_t*, rmw_event_type_t) {
    RMW_SET_ERROR_MSG("no events here");
    return RMW_RET_UNSUPPORTED;
}

}  // extern "C"
