// Reads every type of an OpenIGTLink server with the reference library, and prints one line for each message:
// its type, its device, and what the library found in it. Arguments: the port, the types to wait for.
//
//   g++ -I/usr/include/openigtlink igtl_reference_client.cxx -lOpenIGTLink -lpthread
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <set>
#include <string>

#include "igtlCapabilityMessage.h"
#include "igtlClientSocket.h"
#include "igtlImageMessage.h"
#include "igtlMessageHeader.h"
#include "igtlPointMessage.h"
#include "igtlQuaternionTrackingDataMessage.h"
#include "igtlStatusMessage.h"
#include "igtlStringMessage.h"
#include "igtlTrackingDataMessage.h"
#include "igtlTrajectoryMessage.h"
#include "igtlTransformMessage.h"

static igtl::ClientSocket::Pointer connection;

// The message of a header, its check sum verified; NULL if the library does not accept it.
template <class M> static typename M::Pointer receive(igtl::MessageHeader::Pointer header)
{
  typename M::Pointer message = M::New();
  message->SetMessageHeader(header);
  message->AllocatePack();
  if (message->GetPackBodySize() > 0)
    connection->Receive(message->GetPackBodyPointer(), message->GetPackBodySize());
  if (!(message->Unpack(1) & igtl::MessageHeader::UNPACK_BODY)) return NULL;
  return message;
}

template <class M> static void ask(M message, const char *device)
{
  message->SetDeviceName(device);
  message->Pack();
  connection->Send(message->GetPackPointer(), message->GetPackSize());
}

static void print(const igtl::Matrix4x4 &m)
{
  for (int row = 0; row < 3; row++)
    for (int column = 0; column < 4; column++) printf(" %.6f", m[row][column]);
}

int main(int count, char **arguments)
{
  std::set<std::string> wanted(arguments + 2, arguments + count);
  connection = igtl::ClientSocket::New();
  connection->SetTimeout(10000);
  if (connection->ConnectToServer("127.0.0.1", atoi(arguments[1])) != 0) return 2;

  igtl::StartTrackingDataMessage::Pointer poses = igtl::StartTrackingDataMessage::New();
  poses->SetResolution(10);
  poses->SetCoordinateName("Ras");
  ask(poses, "");
  igtl::StartQuaternionTrackingDataMessage::Pointer turns = igtl::StartQuaternionTrackingDataMessage::New();
  turns->SetResolution(10);
  turns->SetCoordinateName("Ras");
  ask(turns, "");
  ask(igtl::GetImageMessage::New(), "CT");
  ask(igtl::GetCapabilityMessage::New(), "");

  while (!wanted.empty()) {
    igtl::MessageHeader::Pointer header = igtl::MessageHeader::New();
    header->InitPack();
    if (connection->Receive(header->GetPackPointer(), header->GetPackSize()) != header->GetPackSize()) return 3;
    header->Unpack();
    std::string type = header->GetDeviceType();
    igtl::TimeStamp::Pointer stamp = igtl::TimeStamp::New();
    header->GetTimeStamp(stamp);
    printf("%s|%s|%.6f|", type.c_str(), header->GetDeviceName(), stamp->GetTimeStamp());
    bool is_read = true;
    if (type == "TRANSFORM") {
      igtl::TransformMessage::Pointer message = receive<igtl::TransformMessage>(header);
      if ((is_read = message.IsNotNull())) {
        igtl::Matrix4x4 matrix;
        message->GetMatrix(matrix);
        print(matrix);
      }
    } else if (type == "TDATA") {
      igtl::TrackingDataMessage::Pointer message = receive<igtl::TrackingDataMessage>(header);
      if ((is_read = message.IsNotNull()))
        for (int n = 0; n < message->GetNumberOfTrackingDataElements(); n++) {
          igtl::TrackingDataElement::Pointer tool;
          igtl::Matrix4x4 matrix;
          message->GetTrackingDataElement(n, tool);
          tool->GetMatrix(matrix);
          printf(" %s", tool->GetName());
          print(matrix);
        }
    } else if (type == "QTDATA") {
      igtl::QuaternionTrackingDataMessage::Pointer message = receive<igtl::QuaternionTrackingDataMessage>(header);
      if ((is_read = message.IsNotNull()))
        for (int n = 0; n < message->GetNumberOfQuaternionTrackingDataElements(); n++) {
          igtl::QuaternionTrackingDataElement::Pointer tool;
          float place[3], turn[4];
          message->GetQuaternionTrackingDataElement(n, tool);
          tool->GetPosition(place);
          tool->GetQuaternion(turn);
          printf(" %s %.6f %.6f %.6f", tool->GetName(), place[0], place[1], place[2]);
          printf(" %.6f %.6f %.6f %.6f", turn[0], turn[1], turn[2], turn[3]);
        }
    } else if (type == "STATUS") {
      igtl::StatusMessage::Pointer message = receive<igtl::StatusMessage>(header);
      if ((is_read = message.IsNotNull()))
        printf(" %d %s %s", message->GetCode(), message->GetErrorName(), message->GetStatusString());
    } else if (type == "STRING") {
      igtl::StringMessage::Pointer message = receive<igtl::StringMessage>(header);
      if ((is_read = message.IsNotNull())) printf(" %s", message->GetString());
    } else if (type == "POINT") {
      igtl::PointMessage::Pointer message = receive<igtl::PointMessage>(header);
      if ((is_read = message.IsNotNull()))
        for (int n = 0; n < message->GetNumberOfPointElement(); n++) {
          igtl::PointElement::Pointer point;
          float place[3];
          message->GetPointElement(n, point);
          point->GetPosition(place);
          printf(" %s [%s] %.6f %.6f %.6f", point->GetName(), point->GetGroupName(), place[0], place[1], place[2]);
          printf(" %.6f", point->GetRadius());
        }
    } else if (type == "TRAJ") {
      igtl::TrajectoryMessage::Pointer message = receive<igtl::TrajectoryMessage>(header);
      if ((is_read = message.IsNotNull()))
        for (int n = 0; n < message->GetNumberOfTrajectoryElement(); n++) {
          igtl::TrajectoryElement::Pointer line;
          float entry[3], target[3];
          message->GetTrajectoryElement(n, line);
          line->GetEntryPosition(entry);
          line->GetTargetPosition(target);
          printf(" %s %.6f %.6f %.6f", line->GetName(), entry[0], entry[1], entry[2]);
          printf(" %.6f %.6f %.6f", target[0], target[1], target[2]);
        }
    } else if (type == "IMAGE") {
      igtl::ImageMessage::Pointer message = receive<igtl::ImageMessage>(header);
      if ((is_read = message.IsNotNull())) {
        int size[3];
        float spacing[3], centre[3];
        message->GetDimensions(size);
        message->GetSpacing(spacing);
        message->GetOrigin(centre);
        long sum = 0;
        const short *voxels = static_cast<const short *>(message->GetScalarPointer());
        for (long n = 0; n < 1L * size[0] * size[1] * size[2]; n++) sum += voxels[n];
        printf(" %d %d %d", size[0], size[1], size[2]);
        printf(" %.6f %.6f %.6f", spacing[0], spacing[1], spacing[2]);
        printf(" %.6f %.6f %.6f", centre[0], centre[1], centre[2]);
        printf(" %d %d %ld", message->GetScalarType(), message->GetCoordinateSystem(), sum);
      }
    } else if (type == "CAPABILITY") {
      igtl::CapabilityMessage::Pointer message = receive<igtl::CapabilityMessage>(header);
      if ((is_read = message.IsNotNull()))
        for (int n = 0; n < message->GetNumberOfTypes(); n++) printf(" %s", message->GetType(n));
    } else if (type == "RTS_TDATA") {
      igtl::RTSTrackingDataMessage::Pointer message = receive<igtl::RTSTrackingDataMessage>(header);
      if ((is_read = message.IsNotNull())) printf(" %d", message->GetStatus());
    } else {
      connection->Skip(header->GetBodySizeToRead(), 0);
    }
    printf(is_read ? "\n" : " NOT READ\n");
    if (is_read) wanted.erase(type);
  }
  connection->CloseSocket();
  return 0;
}
