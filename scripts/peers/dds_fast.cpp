// Exchanges messages between lsdc-dds and Fast DDS, and checks that they come back complete and unchanged.
//
//   g++ -std=c++17 -O1 -o dds_fast scripts/peers/dds_fast.cpp -lfastrtps -lfastcdr    # libfastrtps-dev on Debian
//   relay /there /back sensor_msgs/msg/Image default &
//   ./dds_fast rt/there rt/back sensor_msgs::msg::dds_::Image_ default 1228856 30
//
// Arguments: topic out, topic back, type, default or latched, bytes of a message, messages.

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/Topic.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

using namespace eprosima::fastdds::dds;
using eprosima::fastrtps::rtps::InstanceHandle_t;
using eprosima::fastrtps::rtps::SerializedPayload_t;
using Bytes = std::vector<unsigned char>;
using Clock = std::chrono::steady_clock;

// A message with its encapsulation, as sent over the wire.
struct RawType : TopicDataType {
    RawType(const std::string& name, size_t largest) {
        setName(name.c_str());
        m_typeSize = largest;
        m_isGetKeyDefined = false;
        auto_fill_type_information(false);
        auto_fill_type_object(false);
    }
    bool serialize(void* data, SerializedPayload_t* payload) override {
        auto& bytes = *static_cast<Bytes*>(data);
        if (payload->max_size < bytes.size()) return false;
        std::memcpy(payload->data, bytes.data(), bytes.size());
        payload->length = bytes.size();
        payload->encapsulation = CDR_LE;
        return true;
    }
    bool deserialize(SerializedPayload_t* payload, void* data) override {
        static_cast<Bytes*>(data)->assign(payload->data, payload->data + payload->length);
        return true;
    }
    std::function<uint32_t()> getSerializedSizeProvider(void* data) override {
        auto size = static_cast<Bytes*>(data)->size();
        return [size] { return static_cast<uint32_t>(size); };
    }
    void* createData() override { return new Bytes; }
    void deleteData(void* data) override { delete static_cast<Bytes*>(data); }
    bool getKey(void*, InstanceHandle_t*, bool) override { return false; }
};

template <typename Policies>
void set(Policies& qos, bool latched) {
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = latched ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
    qos.history().kind = KEEP_LAST_HISTORY_QOS;
    qos.history().depth = latched ? 1 : 10;
    qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
}

Bytes message(size_t size, int seed) {
    Bytes bytes{0, 1, 0, 0};
    for (size_t at = 4; at < size; ++at) bytes.push_back(at * 7 + seed);
    return bytes;
}

int main(int count, char** arguments) {
    if (count != 7) return std::fprintf(stderr, "see the head of the source\n"), 2;
    const std::string out = arguments[1], back = arguments[2], type = arguments[3];
    const bool latched = std::string(arguments[4]) == "latched";
    const size_t size = std::atol(arguments[5]);
    const int messages = std::atoi(arguments[6]);
    const char* domain = std::getenv("ROS_DOMAIN_ID");
    auto* participant = DomainParticipantFactory::get_instance()->create_participant(
        domain ? std::atoi(domain) : 0, PARTICIPANT_QOS_DEFAULT);
    TypeSupport(new RawType(type, size + 64)).register_type(participant);
    DataWriterQos writer_qos;
    set(writer_qos, latched);
    writer_qos.publish_mode().kind = ASYNCHRONOUS_PUBLISH_MODE;
    DataReaderQos reader_qos;
    set(reader_qos, latched);
    auto* reader = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT)
                       ->create_datareader(participant->create_topic(back, type, TOPIC_QOS_DEFAULT), reader_qos);
    auto* writer = participant->create_publisher(PUBLISHER_QOS_DEFAULT)
                       ->create_datawriter(participant->create_topic(out, type, TOPIC_QOS_DEFAULT), writer_qos);
    std::vector<double> times;
    for (int seed = 0; seed <= messages; ++seed) {
        Bytes sent = message(size, seed), received;
        auto start = Clock::now(), written = start;
        writer->write(&sent);
        for (SampleInfo info; received != sent;) {
            reader->wait_for_unread_message({0, 1000000});
            while (reader->take_next_sample(&received, &info) == ReturnCode_t::RETCODE_OK) {
                if (received.size() >= size) break;
            }
            // Fast DDS pads small messages to four bytes without recording it.
            if (received.size() > size && received.size() < size + 4) received.resize(size);
            auto now = Clock::now();
            if (now - start > std::chrono::seconds(20)) {
                std::printf("message %d did not come back; the last has %zu bytes\n", seed, received.size());
                std::fflush(stdout);
                _exit(1);
            }
            // The first message is repeated while the other side is starting, unless it is latched.
            if (seed == 0 && !latched && received != sent && now - written > std::chrono::seconds(1)) {
                written = now;
                writer->write(&sent);
            }
        }
        if (seed > 0) times.push_back(std::chrono::duration<double, std::milli>(Clock::now() - start).count());
    }
    std::sort(times.begin(), times.end());
    std::printf("Fast DDS, %s: %d of %zu bytes there and back, median %.1f ms\n", arguments[4], messages, size,
                times[times.size() / 2]);
    std::fflush(stdout);
    _exit(0);
}
